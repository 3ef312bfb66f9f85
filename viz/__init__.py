"""Results to rerun recordings. Imports `topology` and the result types of `merge`."""
