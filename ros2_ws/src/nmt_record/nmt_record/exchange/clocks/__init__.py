"""What the clock of recorded data is: of a table's columns, of messages, of stamps in words."""
