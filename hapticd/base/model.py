"""What every validated model shares: strict numbers, limits, and faults at their place in pydantic's words.

Models are immutable and strict: a number is a number (neither "1" nor true), finite and inside its limits; an
unknown key is an error. The limits are there so that no product of them overflows or makes the tick work on
nonsense; they are far outside what a hand can feel.
"""

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
    """Has JSON Schema describe what is annotated with it as another type; whoever takes the value validates it."""

    kind: Any

    def __get_pydantic_json_schema__(self, _: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        return handler(TypeAdapter(self.kind).core_schema)


NAME_MAX_CHARACTERS = 64
MOST_KEYS: Final = 256
"""No mapping of known keys has more."""
MAX_FAULTS = 200
"""So many are reported one by one; nobody reads more, and reporting thousands takes seconds."""
UNKNOWN_KEY: Final = "unknown key"
"""How the text of such a fault begins."""
NAME_PATTERN = r"^[^.\u0000-\u001f\u007f-\u009f\u2028\u2029]+$"

Name: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=NAME_MAX_CHARACTERS, pattern=NAME_PATTERN)]
"""Name of a material or id of an object: no dot, so that a path can be read, and no control character."""

Coordinate: TypeAlias = Annotated[float, Field(ge=-10, le=10)]
Position: TypeAlias = Annotated[tuple[Coordinate, Coordinate], Strict(False)]
"""[x, y] in m."""
Stiffness: TypeAlias = Annotated[float, Field(ge=0, le=1e5)]
Damping: TypeAlias = Annotated[float, Field(ge=0, le=1e3)]


class Model(BaseModel):
    """An immutable, strict mapping of known keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)
    by_name: ClassVar[dict[str, type["Model"]]] = {}

    def __init__(self, /, **data: Any) -> None:
        """Raises InvalidError with every fault of the keys that are given."""
        with _invalid():
            super().__init__(**data)

    # As pydantic's own: what is nested is validated without a way through Python.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    @classmethod
    def model_validate(cls, obj: Any, **options: Any) -> Self:
        """As pydantic's, but raises InvalidError."""
        with _invalid():
            return super().model_validate(obj, **options)

    @classmethod
    def model_validate_json(cls, json_data: str | bytes | bytearray, **options: Any) -> Self:
        """As pydantic's, but raises InvalidError."""
        with _invalid():
            return super().model_validate_json(json_data, **options)

    @classmethod
    def model_validate_strings(cls, obj: Any, **options: Any) -> Self:
        """As pydantic's, but raises InvalidError."""
        with _invalid():
            return super().model_validate_strings(obj, **options)

    @classmethod
    def parsed(cls, data: object) -> Self:
        """For readers of documents, which report faults where they stand: raises ValidationError."""
        return super().model_validate(data)

    def __setattr__(self, name: str, value: object) -> None:
        raise _fixed(name)

    def __delattr__(self, name: str) -> None:
        raise _fixed(name)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: object) -> None:
        if Model.by_name.setdefault(cls.__name__, cls) is not cls:
            raise TypeError(f"two models are called {cls.__name__}; error messages tell them apart by name")

    def to_dict(self, without: set[str] | None = None) -> dict[str, Json]:
        """The canonical form as plain data: defaults filled in, absent options left out; valid input.

        `without` these members.
        """
        return cast(dict[str, Json], self.model_dump(mode="json", exclude_none=True, exclude=without))


class CheckedTogether(Model):
    """A model with keys that are each sound, and may not go together."""

    def cross_faults(self) -> list[str]:
        """What is wrong between them."""
        return []

    @model_validator(mode="after")
    def _refuse_cross_faults(self) -> Self:
        faults = self.cross_faults()
        if faults:
            raise ValueError("; ".join(faults))
        return self


def one_of_two(model: Model, one: str, other: str) -> list[str]:
    """What is wrong unless exactly one of two keys is given."""
    given = [key for key in (one, other) if getattr(model, key) is not None]
    has = "both" if given else "neither"
    return [] if len(given) == 1 else [f"needs exactly one of {one} and {other}, has {has}"]


@contextmanager
def _invalid() -> Iterator[None]:
    """pydantic's errors as ours."""
    try:
        yield
    except ValidationError as error:
        raise InvalidError(problems_of(error)) from None


def _fixed(name: str) -> InvalidError:
    return InvalidError([Problem(path_text((name,)), "cannot be changed: model_copy(update=...) makes another one")])


def problems_of(error: ValidationError, root: Path = ()) -> list[Problem]:
    """Every fault of a pydantic error; `root` is where the validated data stands."""
    return [Problem(path_text(root + path), text) for path, text in faults_of(error)]


def faults_of(error: ValidationError) -> list[tuple[Path, str]]:
    """As problems_of, with paths relative to the validated data."""
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
    """What `parse` makes of a mapping, which stands at `where`. It is given one entry at a time, with a pause after
    each: pydantic tells all faults of a call at once, and one entry alone may have thousands.

    Raises InvalidError with the faults of all; after MAX_FAULTS the rest is not read.
    """
    found: dict[str, T] = {}
    problems: list[Problem] = []
    for key, value in given.items():
        if len(problems) >= MAX_FAULTS:
            problems.append(Problem(path_text(where), "the rest was not looked at"))
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
    """Refuses mappings, at any depth, with more keys than any has: telling each of thousands takes seconds."""
    if isinstance(data, dict) and len(data) > MOST_KEYS:
        raise InvalidError([Problem(path_text(path), f"has {len(data)} keys; nothing has more than {MOST_KEYS}")])
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in inner:
        if isinstance(value, dict | list):
            refuse_many_keys(value, (*path, key))


def at_most(count: int) -> BeforeValidator:
    """Refuses a longer list before its entries are validated: the faults of thousands take seconds."""

    def check(given: object) -> object:
        if isinstance(given, list | tuple) and len(given) > count:
            raise ValueError(_too_many(given, count))
        return given

    return BeforeValidator(check)


def check_count(given: Sized, most: int, path: Path) -> None:
    """Raises InvalidError where there are more than that, at this place."""
    if len(given) > most:
        raise InvalidError([Problem(path_text(path), _too_many(given, most))])


def _too_many(given: Sized, most: int) -> str:
    return f"must hold at most {most} entries, holds {len(given)}"


def plain(data: object) -> Json:
    """Mappings, sequences, and numpy's scalars and arrays as dicts, lists, numbers and strings; models stay.

    Raises InvalidError for keys that are no strings, for nesting deeper than MAX_DEPTH and for other objects.
    """
    return cast(Json, _plain(data, ()))


_SCALARS: Final = frozenset({NoneType, bool, int, float, str})
"""Asked of values before anything else is: waypoints and samples have hundreds of thousands."""


def _plain(data: object, path: Path) -> object:
    if isinstance(data, list | tuple):
        _check_depth(path)
        return [value if type(value) in _SCALARS else _plain(value, (*path, index)) for index, value in enumerate(data)]
    if data is None or isinstance(data, bool | int | float | str | Model):
        return data
    if isinstance(data, dict | Mapping):  # a dict is found much sooner than a Mapping is
        _check_depth(path)
        for key in data:
            if not isinstance(key, str):
                raise _not_plain(path, f"keys are strings, this one is {shown(key)}")
        return {
            str(key): value if type(value) in _SCALARS else _plain(value, (*path, str(key)))
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


_PLAINER: Final = {
    "dict_type": "should be a mapping",
    "model_attributes_type": "should be a mapping",
    "model_type": "should be a mapping",
    "tuple_type": "should be a list",
    "union_tag_not_found": "Field required",
}
"""Where pydantic's message has words of Python."""
_WITHOUT_VALUE: Final = frozenset({"missing", "too_long", "too_short", "union_tag_not_found"})
"""Kinds of faults whose message says the value already, or that have none."""


def _fault(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, str]:
    """Where the user sees a fault, and pydantic's message with the value that was found."""
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
    text = _PLAINER.get(kind, details["msg"].removeprefix("Input ").replace("Tuple", "List"))
    if kind == "union_tag_invalid":
        text, value = f"should be one of {context['expected_tags']}", context["tag"]
    return path, text if kind in _WITHOUT_VALUE else f"{text}, is {shown(value)}{_meant(value)}"


def _meant(value: object) -> str:
    """What is probably wrong with a text: a number with a comma, quotes that an editor has curled."""
    if isinstance(value, str) and re.fullmatch(r"[-+]?\d+,\d+", value):
        return "; decimals have a point, not a comma"
    if isinstance(value, str) and value[:1] in tuple("\u201c\u201d\u2018\u2019"):
        return "; quotes are straight: \" or '"
    return ""


def _follows_from_another(details: ErrorDetails) -> bool:
    """Whether a fault is reported only because of another: a list is not too short for its faulty entries."""
    kind, value = details["type"], details["input"]
    too_short = kind == "too_short" and len(value) >= details["ctx"]["min_length"]
    return too_short or kind == "default_factory_not_called"


def _user_path(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, tuple[str, ...]]:
    """Where the user sees the fault, and the keys that are known there.

    pydantic's locations also name the chosen member of a union, and `[key]` for the key of a mapping; walking
    the types along the location tells these from a user's keys of the same name.
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
    """A type without Annotated and without `| None`."""
    while get_origin(annotation) is Annotated:
        annotation = get_args(annotation)[0]
    if get_origin(annotation) in (Union, UnionType):
        members = [member for member in get_args(annotation) if member is not NoneType]
        if len(members) == 1:
            return _bare(members[0])
    return annotation


def _members(kind: object) -> dict[str, object] | None:
    """The models of a union that differ by `kind`, by that kind; None for any other type."""
    if get_origin(kind) not in (Union, UnionType):
        return None
    return dict(_tagged(get_args(kind)))


def _tagged(members: tuple[Any, ...]) -> Iterator[tuple[str, object]]:
    for member in members:
        annotation = member.model_fields["kind"].annotation if issubclass(member, BaseModel) else None
        if get_origin(annotation) is Literal:
            yield from ((tag, member) for tag in get_args(annotation))
