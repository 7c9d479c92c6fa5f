"""The page of missions."""
