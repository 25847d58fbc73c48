"""Pages, figures and tables of tests, responses and diagnoses."""
