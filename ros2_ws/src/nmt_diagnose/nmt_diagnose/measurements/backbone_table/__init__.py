"""Backbones that someone else has reduced."""
