"""JSON Merge Patch against the cases and the pseudocode of RFC 7396."""

import copy
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticd.base.merge_patch import merge_patch
from hapticd.base.yaml_source import Json

# RFC 7396, appendix A: original, patch, result.
APPENDIX_A = [
    ('{"a":"b"}', '{"a":"c"}', '{"a":"c"}'),
    ('{"a":"b"}', '{"b":"c"}', '{"a":"b","b":"c"}'),
    ('{"a":"b"}', '{"a":null}', "{}"),
    ('{"a":"b","b":"c"}', '{"a":null}', '{"b":"c"}'),
    ('{"a":["b"]}', '{"a":"c"}', '{"a":"c"}'),
    ('{"a":"c"}', '{"a":["b"]}', '{"a":["b"]}'),
    ('{"a":{"b":"c"}}', '{"a":{"b":"d","c":null}}', '{"a":{"b":"d"}}'),
    ('{"a":[{"b":"c"}]}', '{"a":[1]}', '{"a":[1]}'),
    ('["a","b"]', '["c","d"]', '["c","d"]'),
    ('{"a":"b"}', '["c"]', '["c"]'),
    ('{"a":"foo"}', "null", "null"),
    ('{"a":"foo"}', '"bar"', '"bar"'),
    ('{"e":null}', '{"a":1}', '{"e":null,"a":1}'),
    ("[1,2]", '{"a":"b","c":null}', '{"a":"b"}'),
    ("{}", '{"a":{"bb":{"ccc":null}}}', '{"a":{"bb":{}}}'),
]

# RFC 7396, section 3.
DOCUMENT = """{"title": "Goodbye!", "author": {"givenName": "John", "familyName": "Doe"},
               "tags": ["example", "sample"], "content": "This will be unchanged"}"""
PATCH = """{"title": "Hello!", "phoneNumber": "+01-123-456-7890", "author": {"familyName": null},
            "tags": ["example"]}"""
RESULT = """{"title": "Hello!", "author": {"givenName": "John"}, "tags": ["example"],
             "content": "This will be unchanged", "phoneNumber": "+01-123-456-7890"}"""

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("abcd"), inner, max_size=4),
    max_leaves=20,
)


def rfc_pseudocode(target: Json, patch: Json) -> Json:
    """Transcribe the pseudocode of section 2."""
    if isinstance(patch, dict):
        if not isinstance(target, dict):
            target = {}
        for name, value in patch.items():
            if value is None:
                if name in target:
                    del target[name]
            else:
                target[name] = rfc_pseudocode(target.get(name), value)
        return target
    return patch


@pytest.mark.parametrize(("original", "patch", "result"), [*APPENDIX_A, (DOCUMENT, PATCH, RESULT)])
def test_cases_of_the_rfc(original: str, patch: str, result: str) -> None:
    assert merge_patch(json.loads(original), json.loads(patch)) == json.loads(result)


@given(json_values, json_values)
@pytest.mark.slow
def test_equals_the_pseudocode_and_changes_neither_argument(target: Json, patch: Json) -> None:
    target_before, patch_before = copy.deepcopy(target), copy.deepcopy(patch)
    assert merge_patch(target, patch) == rfc_pseudocode(copy.deepcopy(target), patch)
    assert target == target_before
    assert patch == patch_before
