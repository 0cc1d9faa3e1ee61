"""A hypothesis fitted to recordings, and judged on those that its fit did not see."""
