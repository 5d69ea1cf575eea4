"""Axes drawn at random: what every estimator and its default settings must get along with."""
