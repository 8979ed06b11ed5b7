"""Independent witnesses: slow, plain, and sharing no code with what they judge."""
