"""Choice among causes that are columns about one fit."""
