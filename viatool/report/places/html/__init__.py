"""A certificate as a page."""
