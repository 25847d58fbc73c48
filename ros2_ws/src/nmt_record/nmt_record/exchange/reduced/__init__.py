"""Tables that others have reduced: backbones and frequency responses."""
