"""The formats: each module serves every kind of run whose document offers what it needs."""
