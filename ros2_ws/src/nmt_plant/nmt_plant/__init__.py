"""The rig as a device: contract, oscillator, converters, safety, the process that owns an output; plant node.

Import what you need from its module, so that reading a rig file does not load the solvers:

* :mod:`nmt_plant.devices`: the contract ``device.Device``, ``simulated_rig.SimulatedRig``, hardware, loopback.
* :mod:`nmt_plant.converters`, :mod:`nmt_plant.output_process`: what puts samples out, and the process that owns it.
* :mod:`nmt_plant.safety`: guard of the output, limits, watchdog.
* :mod:`nmt_plant.check`: the check before a real test.
* :mod:`nmt_plant.plant_node`: the node.
"""
