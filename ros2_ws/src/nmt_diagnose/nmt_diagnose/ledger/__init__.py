"""The ledger of decisions: a row for each explanation, and the rules that state it or not."""
