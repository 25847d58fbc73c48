"""Tables written as text: how their columns are written, and what the lines above them say."""
