"""Models as programs for controllers and simulators: C, Python, MATLAB, and functional mock-up units.

A program takes the steps of `phnn.trajectory`. Laws and blocks are translated from their own source texts
(`phnn.exporting.laws`), so that there is no second description of any of them.
"""
