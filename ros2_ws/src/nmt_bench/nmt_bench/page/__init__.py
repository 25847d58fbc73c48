"""The live page: watch, steer and stop a test in the browser; only :mod:`nmt_bench.page.page_node` imports ROS 2."""
