"""Series whose neighbouring samples depend on each other: noise, tests, what a fit to them is worth."""
