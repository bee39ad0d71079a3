"""Experiments: many training runs, spread over the machine, and what they show together.

runs.py      a run of an experiment: label, method, overrides, seed -> run folder and `tandem train` command
ablation.py  config/ablations/NAME.yaml -> runs
machines.py  where a command is started and waited for: this machine, or Ray
runner.py    spreads runs over a machine; a second call goes on where the first one was stopped
figures.py   finished runs -> rows of a table
pictures.py  rows and curves -> pictures
report.py    rows and pictures -> report.md, report.csv
"""
