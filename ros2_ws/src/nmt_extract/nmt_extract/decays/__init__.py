"""Modal properties along free decays: with linear modes and force, and channel by channel without them."""
