"""Tandem: a robot arm, a learning policy and a person, driving together."""

__version__ = "0.1.0"
