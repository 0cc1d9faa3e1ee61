"""The same steps for many trajectories at once: the last axis of every array is the lane."""
