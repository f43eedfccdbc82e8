"""What `python -m benchmarks.hostile` calls: every public name, with valid arguments and with hostile ones.

A new public name, or a parameter of one, needs an example in `arguments`. `things` has what examples are made
of, `values` what hostile callers give instead; `valid_calls` puts calls together.
"""
