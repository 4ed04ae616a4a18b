"""Workers of a sweep: where and by what its runs are computed.

Open first: ``execution`` (workers, engine and merged folders, as a user states them), ``backend`` (this
process, or local worker processes), ``job`` (one run as sent to a worker, and its record).

``batch_job`` simulates jobs together, ``dask_backend`` hands them to a cluster, ``worker_host`` is the
program of a local worker.

Imports what ``sweeps`` imports.
"""
