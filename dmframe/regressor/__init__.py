"""Dynamic regressor: exact base parameters, readable equations, generated code, proofs."""
