"""Workers of a sweep: execution, jobs, and local or dask processes that run them."""
