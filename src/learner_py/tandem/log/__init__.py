"""Reads LCM event logs: the one reader of this tree.

files       log.lcm, log.lcm.01 ... as one
events      where events begin, many at a time; damage and cut-off tails
index       columns of all events, kept beside a large log
layout      messages of one shape as numpy records
event_log   EventLog: events and columns of an opened log
messages    typed messages, whole episodes, the scenario
"""

from tandem.log.event_log import EventLog, RawEvent
from tandem.log.messages import LogMessage, episodes, messages, raw_events, scenario_yaml

__all__ = ["EventLog", "LogMessage", "RawEvent", "episodes", "messages", "raw_events", "scenario_yaml"]
