"""The measuring chain of a diagnosis: its errors as columns beside those of the model."""
