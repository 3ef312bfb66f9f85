"""Digests of maps."""

from dataclasses import replace

from topobatch.merge.digests import digest_of


def test_the_digest_is_that_of_the_content(halves):
    one, other = halves
    assert digest_of(one) == digest_of(replace(one, run="renamed", info={}))
    assert digest_of(one) != digest_of(other)
    assert digest_of(one) != digest_of(replace(one, length=one.length + 0.001))
    assert digest_of(one) != digest_of(replace(one, noise=replace(one.noise, scale=0.006)))
    bent = (one.paths[0] + [[0.0, 0.001]] * len(one.paths[0]), *one.paths[1:])
    assert digest_of(one) != digest_of(replace(one, paths=bent))
