"""What is asked: one object, checked where it is made."""
