"""`slam batch`: many logs under many settings, on Dask."""
