"""A folder of evidence: what is claimed, what it rests on, what was read, and what was found, for people who review."""
