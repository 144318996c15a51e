"""Text of models in other languages."""
