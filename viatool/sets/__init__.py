"""Sets of states: boxes of poses, and linear forms over them."""
