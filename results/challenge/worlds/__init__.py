"""The challenge's worlds: arms from URDF files, and the conditions, motions and logs of
their runs.

As in ``sdp_vs_penalty/simulation/worlds``, which makes their torque, nothing here
imports effects, signals or regression; ``tests/simulation/test_challenge.py`` looks.
"""
