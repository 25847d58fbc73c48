"""The rig: structural models, shaker, sensors, time integration, reference solutions; plant node.

Import what you need from its module, so that reading a rig file does not load the solvers:

* :mod:`nmt_rig.rig`: ``load_rig``, ``Rig``; :mod:`nmt_rig.rig_model`: from a rig to its model.
* :mod:`nmt_plant.device`: the contract ``Device``; :mod:`nmt_plant.simulated_rig`: ``SimulatedRig``.
* :mod:`nmt_rig.reference`: ``compute_reference`` (EPMC), ``single_point_reference``.
* :mod:`nmt_rig.linear_description`: what loop and extraction need to know of a rig.
* :mod:`nmt_rig.model`: beams, chains, shakers, local elements, time integration, harmonic balance.
* :mod:`nmt_plant.plant_node`: the node.
"""
