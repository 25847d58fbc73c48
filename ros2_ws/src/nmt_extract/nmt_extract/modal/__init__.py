"""The evaluation of a window: harmonics, judgement, quantities, point, for every kind of test.

:mod:`~nmt_extract.modal.channels` says which rows of a window are what, :mod:`~nmt_extract.modal.periodic_motion` finds
its harmonics, :mod:`~nmt_extract.modal.channel_findings` judges it,
:mod:`~nmt_extract.modal.quantities` and :mod:`~nmt_extract.modal.secondary_quantities` say what follows, and
:mod:`~nmt_extract.modal.evaluation` and :mod:`~nmt_extract.modal.free_motion` make the point, of which
:mod:`~nmt_extract.modal.point` is the one entry.
"""
