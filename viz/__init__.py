"""Results to rerun recordings, drawings and pages; imports `topology` and the results of `merge`.

rerun and matplotlib take up to a second to import: commands import the modules that use them when
they write.
"""
