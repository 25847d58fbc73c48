"""What a diagnosis says: sentences, rows of diagnosis.json, maps and tests of what is left."""
