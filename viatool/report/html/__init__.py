"""Pages: the parts that all of them share, and the page of a result."""
