"""Run time beside error: `python -m benchmarks [name] [--small]`.

Every benchmark is a module with a generator ``rows(small)``. Rivals run in one process, warm and in
turns, on data that are passed as arguments; a row of a record holds a time and an error together.
The errors are measured by ``truth``, which shares no code with jaxstab.
"""
