"""What `tandem bench policy` measures.

policies       the networks and their targets       weights      random policy files of them
onnx_graph     a builder of ONNX graphs             onnx_policies  the same networks as such graphs
engine         a peer's program                     contenders   everyone, as child processes
cost           bytes and operations of a policy     measure      the rounds
report         the figures
"""

from tandem.policy_bench.policies import POLICIES, BenchPolicy

__all__ = ["POLICIES", "BenchPolicy"]
