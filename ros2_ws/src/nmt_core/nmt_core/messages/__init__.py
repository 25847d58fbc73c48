"""What nodes send to each other: the records, and their form as bytes."""
