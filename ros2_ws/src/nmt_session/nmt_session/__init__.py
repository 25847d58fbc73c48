"""One test in one process without ROS, and the plan that it shares with the nodes."""

from nmt_session.node_plan import NodePlan, plan_nodes
from nmt_session.plan_of_test import TestPlan
from nmt_session.planning import plan_test
from nmt_session.run_result import Progress, RunResult
from nmt_session.session import Session

__all__ = ["NodePlan", "Progress", "RunResult", "Session", "TestPlan", "plan_nodes", "plan_test"]
