"""What a filter must satisfy. Each check is a function that returns a result with its reason."""
