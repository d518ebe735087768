"""Execution of studies: processes of this machine or a Dask cluster, chunks that survive an interruption."""
