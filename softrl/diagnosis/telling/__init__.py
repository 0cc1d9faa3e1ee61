"""The finding in words, numbers and figures, and what to record next."""
