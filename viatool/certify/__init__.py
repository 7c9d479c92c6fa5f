"""Certified places."""
