"""What a person decided about pairs of runs."""

import pytest

from topobatch.merge.locks import Lock, locks_from_document, with_lock, without_lock
from topobatch.topology.errors import DocumentError, UsageError


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("a", "a", "same"), "two runs"),
        (("a", "b", "maybe"), "'same' or 'never'"),
        (("a", "b", "same", (1, -2)), "one vertex of each"),
        (("a", "b", "never", (1, 2)), "whole runs"),
    ],
)
def test_what_no_lock_can_be(arguments, message):
    with pytest.raises(UsageError, match=message):
        Lock(*arguments)


def test_a_new_lock_replaces_the_old_one_of_its_pair():
    locks = with_lock(with_lock((), Lock("b", "c", "never")), Lock("a", "b", "same"))
    assert [(k.a, k.b, k.decision) for k in locks] == [("a", "b", "same"), ("b", "c", "never")]
    locks = with_lock(locks, Lock("b", "a", "never"))
    assert [(k.a, k.b, k.decision) for k in locks] == [("a", "b", "never"), ("b", "c", "never")]
    assert without_lock(locks, "c", "b") == (Lock("a", "b", "never"),)
    assert without_lock(locks, "x", "y") == locks


def _document(*locks, schema="topobatch.locks/1"):
    return {"schema": schema, "locks": [dict(zip("ab", k, strict=True)) | v for k, v in locks]}


@pytest.mark.parametrize(
    "doc",
    [
        {},
        [],
        {"schema": "topobatch.locks/1", "locks": [{"a": "x"}]},
        {"schema": "topobatch.locks/1", "locks": [{"a": 1, "b": 2}]},
        {"locks": []},
        _document(schema="topobatch.locks/2"),
        _document(("xx", {"decision": "same"})),
        _document(("xy", {"decision": "same"}), ("yx", {"decision": "never"})),
        _document(("xy", {"decision": "never", "at": [1, 2]})),
        _document(("xy", {"decision": "same", "at": [-1, 2]})),
    ],
)
def test_what_is_no_locks_document(doc):
    with pytest.raises(DocumentError, match=r"locks\.json"):
        locks_from_document(doc, "locks.json")
