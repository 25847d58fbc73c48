"""Texts for people: numbers in words, tables, options, the nearest known word."""
