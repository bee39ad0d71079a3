"""LeRobot's ACT checkpoints -> our policy files: `convert`."""

from tandem.lerobot_act.convert import convert

__all__ = ["convert"]
