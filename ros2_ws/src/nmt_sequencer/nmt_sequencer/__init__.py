"""Level plans and the state machine of a test run; sequencer node."""
