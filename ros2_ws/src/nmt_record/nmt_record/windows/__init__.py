"""The windows of a recording: which samples a lock event names, and whether they can be used."""
