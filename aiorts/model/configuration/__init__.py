"""The rules of configuration: parameters with constraints, configuration sets, and their texts.

A `ConfigurationState` is a value: a change makes another one or raises ConfigurationError. `aiorts.kernel` puts one in
force between two cycles.
"""
