"""Fits of explanations: noise, chain and scales, most probable parameters, evidence."""
