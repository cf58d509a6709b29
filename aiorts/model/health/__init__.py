"""The figures of a system in windows of time, and the decision whether one window is worse than the one before."""
