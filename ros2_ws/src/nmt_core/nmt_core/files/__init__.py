"""Files read from anybody and written whole."""
