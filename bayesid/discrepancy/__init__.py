"""What a model lacks to explain a log: compare, name, add, show."""
