"""Base class of validated models: strict numbers, limits, and faults with their paths and pydantic's texts.

Models are immutable and strict: a number is a number (neither "1" nor true), finite and inside its limits. An unknown
key is an error. The limits are far outside what a hand can feel; they keep products of values from overflowing.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Final, Literal, Self, TypeAlias, TypeVar, Union, cast, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    Strict,
    StringConstraints,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, ErrorDetails

from hapticd.base.errors import InvalidError, Path, Problem, known_names, path_text, shown
from hapticd.base.steps import Steps
from hapticd.base.yaml_source import MAX_DEPTH, Json

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class DescribedAs:
    """Annotation of a value that JSON Schema describes as the type `kind`; the code that uses it validates it."""

    kind: Any

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.kind).core_schema)


MAX_NAME_CHARACTERS = 64
MAX_KEYS_OF_MAPPING: Final = 256
"""Largest number of keys of a mapping; every model has fewer."""
MAX_FAULTS = 200
"""More faults than this are counted, not reported, because to report thousands takes seconds."""
UNKNOWN_KEY: Final = "unknown key"
"""Beginning of the text of a fault: a key that the model does not have."""
NAME_PATTERN = r"^[^.\u0000-\u001f\u007f-\u009f\u2028\u2029]+$"
"""Pattern of a Name: neither dots nor control characters."""

Name: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=MAX_NAME_CHARACTERS, pattern=NAME_PATTERN)]
"""Name of a material or id of an object: without a dot, which separates the keys of a path."""

Coordinate: TypeAlias = Annotated[float, Field(ge=-10, le=10)]
"""A coordinate of the workspace, in m."""
Position: TypeAlias = Annotated[tuple[Coordinate, Coordinate], Strict(False)]
"""[x, y] in m."""
Stiffness: TypeAlias = Annotated[float, Field(ge=0, le=1e5)]
"""A stiffness, in N/m."""
Damping: TypeAlias = Annotated[float, Field(ge=0, le=1e3)]
"""A damping coefficient, in N s/m."""


class Model(BaseModel):
    """An immutable, strict mapping of known keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    by_name: ClassVar[dict[str, type["Model"]]] = {}

    def __init__(self, /, **data: Any) -> None:
        """Create the model from its keys, and validate them. Raises InvalidError with every fault."""
        with _invalid():
            super().__init__(**data)

    # Marked as pydantic's own, so that nested models are validated without a call of Python.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """Validate as pydantic does, but raise InvalidError."""
        with _invalid():
            return super().model_validate(obj, **options)

    @classmethod
    def model_validate_json(cls, json_data: str | bytes | bytearray, **options: Any) -> Self:
        """Validate as pydantic does, but raise InvalidError."""
        with _invalid():
            return super().model_validate_json(json_data, **options)

    @classmethod
    def model_validate_strings(cls, obj: Any, **options: Any) -> Self:
        """Validate as pydantic does, but raise InvalidError."""
        with _invalid():
            return super().model_validate_strings(obj, **options)

    @classmethod
    def parsed(cls, data: object) -> Self:
        """Validate data and return the model. Raises pydantic's ValidationError, without file and line."""
        return super().model_validate(data)

    def __setattr__(self, name: str, value: object) -> None:
        raise _fixed(name)

    def __delattr__(self, name: str) -> None:
        raise _fixed(name)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: object) -> None:
        if Model.by_name.setdefault(cls.__name__, cls) is not cls:
            raise TypeError(f"two models are called {cls.__name__}; error messages find a model by its name")

    def to_dict(self, without: set[str] | None = None) -> dict[str, Json]:
        """Return the model as plain data, which is valid input: with all defaults, without optional keys that are null.

        `without` names members to leave out.
        """
        return cast(dict[str, Json], self.model_dump(mode="json", exclude_none=True, exclude=without))


class CheckedTogether(Model):
    """A model some of whose keys may be valid one by one but not in combination."""

    def cross_faults(self) -> list[str]:
        """Return a text for each invalid combination of keys."""
        return []

    @model_validator(mode="after")
    def _refuse_cross_faults(self) -> Self:
        faults = self.cross_faults()
        if faults:
            raise ValueError("; ".join(faults))
        return self


def one_of_two(model: Model, one: str, other: str) -> list[str]:
    """Return [] if exactly one of two keys of a model is given, else a list with the text of the fault."""
    given = [key for key in (one, other) if getattr(model, key) is not None]
    has = "both" if given else "neither"
    return [] if len(given) == 1 else [f"needs exactly one of {one} and {other}, has {has}"]


@contextmanager
def _invalid() -> Iterator[None]:
    """Raise InvalidError for a ValidationError of pydantic in the `with` block."""
    try:
        yield
    except ValidationError as error:
        raise InvalidError(problems_of(error)) from None


def _fixed(name: str) -> InvalidError:
    return InvalidError([Problem(path_text((name,)), "cannot be changed; model_copy(update=...) makes a changed copy")])


def problems_of(error: ValidationError, root: Path = ()) -> list[Problem]:
    """Return every fault of a pydantic error; `root` is the path of the validated data."""
    return [Problem(path_text(root + path), text) for path, text in faults_of(error)]


def faults_of(error: ValidationError) -> list[tuple[Path, str]]:
    """Return every fault of a pydantic error as its path, relative to the validated data, and its text."""
    faults: dict[tuple[Path, str], None] = {}
    found_here = error.errors(include_url=False)
    for details in found_here[:MAX_FAULTS]:
        if not _follows_from_another(details):
            faults[_fault(Model.by_name.get(error.title), details)] = None
    found = list(faults)
    if len(found_here) > MAX_FAULTS:
        found.append(((), f"has {len(found_here) - MAX_FAULTS} more faults"))
    return found


def entry_by_entry(
    given: Mapping[str, object], parse: Callable[[dict[str, object]], Mapping[str, T]], where: Path
) -> Steps[dict[str, T]]:
    """Parse a mapping, whose path is `where`, entry by entry: a generator that yields after each entry.

    `parse` gets one entry at a time, because pydantic reports all faults of a call at once, possibly thousands. Raises
    InvalidError with the faults of all entries; after MAX_FAULTS faults the other entries are not parsed.
    """
    found: dict[str, T] = {}
    problems: list[Problem] = []
    for key, value in given.items():
        if len(problems) >= MAX_FAULTS:
            problems.append(Problem(path_text(where), "the other entries were not checked"))
            break
        try:
            found |= parse({key: value})
        except InvalidError as error:
            problems += error.problems
        yield
    if problems:
        raise InvalidError(problems)
    return found


def refuse_many_keys(data: object, path: Path) -> None:
    """Raise InvalidError if a mapping in `data`, at any depth, has more than MAX_KEYS_OF_MAPPING keys."""
    if isinstance(data, dict) and len(data) > MAX_KEYS_OF_MAPPING:
        raise InvalidError(
            [Problem(path_text(path), f"has {len(data)} keys; at most {MAX_KEYS_OF_MAPPING} are allowed")]
        )
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inner:
        if isinstance(value, dict | list):
            refuse_many_keys(value, (*path, key))


def at_most(count: int) -> BeforeValidator:
    """Return a validator that refuses a list with more than `count` entries, before it validates them one by one."""

    def check(given: object) -> object:
        if isinstance(given, list | tuple) and len(given) > count:
            raise ValueError(_too_many(given, count))
        return given

    return BeforeValidator(check)


def check_count(given: Sized, max_count: int, path: Path) -> None:
    """Raise InvalidError if the collection `given`, whose place is `path`, has more than `max_count` entries."""
    if len(given) > max_count:
        raise InvalidError([Problem(path_text(path), _too_many(given, max_count))])


def _too_many(given: Sized, max_count: int) -> str:
    return f"must hold at most {max_count} entries, holds {len(given)}"


def plain(data: object) -> Json:
    """Convert mappings, sequences, and numpy's scalars and arrays to dicts, lists, numbers and strings.

    Models are kept. Raises InvalidError for keys that are not strings, for nesting deeper than MAX_DEPTH and for other
    objects.
    """
    return cast(Json, _plain(data, ()))


_SCALAR_TYPES: Final = frozenset({NoneType, bool, int, float, str})
"""Types of values that need no conversion; tested first, as waypoints and samples have hundreds of thousands."""


def _plain(data: object, path: Path) -> object:
    if isinstance(data, list | tuple):
        _check_depth(path)
        return [
            value if type(value) in _SCALAR_TYPES else _plain(value, (*path, index)) for index, value in enumerate(data)
        ]
    if data is None or isinstance(data, bool | int | float | str | Model):
        return data
    if isinstance(data, dict | Mapping):  # isinstance of a dict is much faster than of a Mapping
        _check_depth(path)
        for key in data:
            if not isinstance(key, str):
                raise _not_plain(path, f"keys must be strings, this one is {shown(key)}")
        return {
            str(key): value if type(value) in _SCALAR_TYPES else _plain(value, (*path, str(key)))
            for key, value in data.items()
        }
    if hasattr(data, "tolist"):
        return _plain(data.tolist(), path)
    raise _not_plain(path, f"is not plain data: {shown(data)}")


def _check_depth(path: Path) -> None:
    if len(path) == MAX_DEPTH:
        raise _not_plain(path[:3], f"nested deeper than {MAX_DEPTH} levels")


def _not_plain(path: Path, problem: str) -> InvalidError:
    return InvalidError([Problem(path_text(path), problem)])


_REPLACED_MESSAGES: Final = {
    "dict_type": "should be a mapping",
    "model_attributes_type": "should be a mapping",
    "model_type": "should be a mapping",
    "tuple_type": "should be a list",
    "union_tag_not_found": "Field required",
}
"""Texts that replace pydantic's, which name Python types, by the type of a fault."""
_KINDS_WITHOUT_VALUE: Final = frozenset({"missing", "too_long", "too_short", "union_tag_not_found"})
"""Types of faults whose text contains the value already, or that have no value."""


def _fault(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, str]:
    """Return the path of a fault in the user's document, and its text: pydantic's, with the invalid value."""
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    path, known = _user_path(model, details)
    if kind == "extra_forbidden":
        return path, f"{UNKNOWN_KEY}; {known_names(str(path[-1]), known)}"
    if kind == "value_error":
        return path, str(context["error"])
    if kind == "string_pattern_mismatch" and context["pattern"] == NAME_PATTERN:
        return path, f"must not hold a dot or a control character: {shown(value)}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        path = (*path, "kind")
    text = _REPLACED_MESSAGES.get(kind, details["msg"].removeprefix("Input ").replace("Tuple", "List"))
    if kind == "union_tag_invalid":
        text, value = f"should be one of {context['expected_tags']}", context["tag"]
    key = next((part for part in reversed(path) if isinstance(part, str)), "")
    # A waypoint is [t_s, x_m, y_m].
    is_length = (key.endswith("_m") and not key.endswith("_per_m")) or (key == "waypoints" and path[-1] != 0)
    if (
        kind in ("less_than_equal", "greater_than_equal")
        and is_length
        and context.get("ge", -math.inf) <= value / 1e3 <= context.get("le", math.inf)
    ):
        return path, f"{text}, is {shown(value)}; if it is in mm, write {value / 1e3:g}"
    return path, text if kind in _KINDS_WITHOUT_VALUE else f"{text}, is {shown(value)}{_advice(value)}"


def _advice(value: object) -> str:
    """Return advice on a string with a decimal comma, or with an editor's curly quotes; else ""."""
    if isinstance(value, str) and re.fullmatch(r"[-+]?\d+,\d+", value):
        return "; decimals have a point, not a comma"
    if isinstance(value, str) and value[:1] in tuple("\u201c\u201d\u2018\u2019"):
        return "; quotes are straight: \" or '"
    return ""


def _follows_from_another(details: ErrorDetails) -> bool:
    """Return whether a fault only follows from another: a list is "too short" because of its faulty entries."""
    kind, value = details["type"], details["input"]
    too_short = kind == "too_short" and len(value) >= details["ctx"]["min_length"]
    return too_short or kind == "default_factory_not_called"


def _user_path(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, tuple[str, ...]]:
    """Return the path of a fault in the user's document, and the keys that are known there.

    pydantic's locations also name the chosen member of a union, and `[key]` for the key of a mapping. Following the
    types along the location distinguishes these from a user's keys of the same name.
    """
    location = details["loc"]
    if details["type"].startswith("string_") and location and location[-1] == "[key]":
        location = location[:-1]
    path: list[str | int] = []
    here: object = model
    known: tuple[str, ...] = ()
    for element in location:
        members = _members(here)
        if members is not None:
            here = members.get(str(element))
            continue
        path.append(element)
        if isinstance(here, type) and issubclass(here, BaseModel):
            fields = {each.alias or name: each for name, each in here.model_fields.items()}
            known = tuple(fields)
            field = fields.get(str(element))
            here = None if field is None else _bare(field.annotation)
        else:
            arguments = get_args(here)
            is_list = arguments[-1:] == (Ellipsis,)
            here = _bare(arguments[0 if is_list else -1]) if arguments else None
    return tuple(path), known


def _bare(annotation: object) -> object:
    """Return a type without its `Annotated` and `| None`."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, UnionType):
        members = [member for member in get_args(annotation) if member is not NoneType]
        if len(members) == 1:
            return _bare(members[0])
    return annotation


def _members(kind: object) -> dict[str, object] | None:
    """Return the models of a union, each by its value of the key `kind`; None if `kind` is another type."""
    if get_origin(kind) not in (Union, UnionType):
        return None
    return dict(_tagged(get_args(kind)))


def _tagged(members: tuple[Any, ...]) -> Iterator[tuple[str, object]]:
    for member in members:
        annotation = member.model_fields["kind"].annotation if issubclass(member, BaseModel) else None
        if get_origin(annotation) is Literal:
            yield from ((tag, member) for tag in get_args(annotation))
