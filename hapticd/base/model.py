"""What every validated model shares: strict numbers, limits, and faults in the user's words.

Models are immutable and strict: a number is a number (neither "1" nor true), finite and inside its limits; an
unknown key is an error. The limits are there so that no product of them overflows or makes the tick work on
nonsense; they are far outside what a hand can feel.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence, Sized
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

from hapticd.base.errors import InvalidError, Path, Problem, known_names, near_names, path_text, shown
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
    """Every fault of a pydantic error, in plain words; `root` is where the validated data stands."""
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


def one_by_one(
    given: Mapping[str, object], parse: Callable[[str, object], T], root: Path, name: str
) -> Steps[dict[str, T]]:
    """What `parse` makes of each entry of a mapping, which stands below `root` as `name`; a pause after each.

    Raises InvalidError with the faults of all; after MAX_FAULTS the rest is not read.
    """
    found: dict[str, T] = {}
    problems: list[Problem] = []
    for key, value in given.items():
        if len(problems) >= MAX_FAULTS:
            problems.append(Problem(path_text((*root, name)), "the rest was not looked at"))
            break
        try:
            found[key] = parse(key, value)
        except InvalidError as error:
            problems += error.problems
        yield
    if problems:
        raise InvalidError(problems)
    return found


def refuse_many_keys(data: object, path: Path) -> None:
    """Refuses mappings, at any depth, with more keys than any has: telling each of thousands takes seconds."""
    level: list[tuple[Path, object]] = [(path, data)]
    for _ in range(MAX_DEPTH):
        below: list[tuple[Path, object]] = []
        for where, value in level:
            if isinstance(value, dict):
                if len(value) > MOST_KEYS:
                    raise InvalidError(
                        [Problem(path_text(where), f"has {len(value)} keys; nothing has more than {MOST_KEYS}")]
                    )
                below += [((*where, key), inner) for key, inner in value.items() if isinstance(inner, dict | list)]
            elif isinstance(value, list):
                below += [((*where, index), inner) for index, inner in enumerate(value) if isinstance(inner, dict)]
        if not below:
            return
        level = below


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


_PLAIN: Final = frozenset({NoneType, bool, int, float, str})


class _NotPlainError(Exception):
    """What is wrong, and where: the path is built from its end, as the search withdraws."""

    def __init__(self, problem: str) -> None:
        self.problem = problem
        self.path: list[str | int] = []


def _follows_from_another(details: ErrorDetails) -> bool:
    """Whether a fault is reported only because of another: a list is not too short for its faulty entries."""
    kind, value = details["type"], details["input"]
    too_short = kind == "too_short" and len(value) >= details["ctx"]["min_length"]
    return too_short or kind == "default_factory_not_called"


def plain(data: object) -> Json:
    """Mappings, sequences, and numpy's scalars and arrays as dicts, lists, numbers and strings; models stay.

    Raises InvalidError for keys that are no strings, for nesting deeper than MAX_DEPTH and for other objects.
    """
    try:
        return cast(Json, _plain(data, MAX_DEPTH))
    except _NotPlainError as error:
        path = error.path[::-1]
        too_deep = len(path) == MAX_DEPTH
        raise InvalidError([Problem(path_text(path[:3] if too_deep else path), error.problem)]) from None


def _plain(data: object, depth_left: int) -> object:
    # What is asked of every value is asked by its very type; isinstance of Mapping and Model is slow.
    kind = type(data)
    is_mapping, is_list = kind is dict, kind is list
    if not (is_mapping or is_list):
        if kind in _PLAIN or isinstance(data, bool | int | float | str | Model):
            return data
        is_mapping, is_list = isinstance(data, Mapping), isinstance(data, list | tuple)
    if depth_left == 0:
        raise _NotPlainError(f"nested deeper than {MAX_DEPTH} levels")
    if is_mapping:
        given = cast(Mapping[object, object], data)
        for key in given:
            if not isinstance(key, str):
                raise _NotPlainError(f"keys are strings, this one is {shown(key)}")
        return {
            str(key): value if type(value) in _PLAIN else _plain_inside(str(key), value, depth_left)
            for key, value in given.items()
        }
    if is_list:
        return [
            value if type(value) in _PLAIN else _plain_inside(index, value, depth_left)
            for index, value in enumerate(cast(Sequence[object], data))
        ]
    if hasattr(data, "tolist"):
        return _plain(data.tolist(), depth_left)
    raise _NotPlainError(f"is not plain data: {shown(data)}")


def _plain_inside(element: str | int, data: object, depth_left: int) -> object:
    try:
        return _plain(data, depth_left - 1)
    except _NotPlainError as error:
        error.path.append(element)
        raise


def _fault(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, str]:
    kind, value, context = details["type"], details["input"], details.get("ctx", {})
    path, known, expected = _user_path(model, details)
    match kind:
        case "missing" if path and isinstance(path[-1], int):
            return path[:-1], f"must be {_pair(path[:-1])}, has {len(value)}"
        case "missing":
            return path, "is missing"
        case "too_long" if context["field_type"] == "Tuple" and not _is_list(expected):
            return path, f"must be {_pair(path)}, has {len(value)}"
        case "tuple_type" if not _is_list(expected):
            return path, f"must be {_pair(path)}, is {_shown_with_hint(value)}"
        case "tuple_type":
            return path, f"must be a list, is {_shown_with_hint(value)}"
        case "too_long":
            return path, f"must hold at most {context['max_length']} entries, holds {len(value)}"
        case "too_short":
            entries = "entry" if context["min_length"] == 1 else "entries"
            return path, f"must hold at least {context['min_length']} {entries}, holds {len(value)}"
        case "extra_forbidden":
            return path, f"{UNKNOWN_KEY}; {known_names(str(path[-1]), known)}"
        case "union_tag_invalid":
            kinds = context["expected_tags"].replace("'", "").split(", ")
            tag = context["tag"]
            return (*path, "kind"), f"unknown kind {shown(tag)}; {known_names(tag, kinds)}"
        case "union_tag_not_found":
            return (*path, "kind"), "is missing"
        case "finite_number":
            return path, f"must be finite, is {shown(value)}"
        case "float_type" if isinstance(value, int) and not isinstance(value, bool):
            return path, f"is too large: {shown(value)}"
        case "greater_than_equal":
            return path, f"must be at least {_number(context['ge'])}, is {shown(value)}"
        case "greater_than":
            return path, f"must be more than {_number(context['gt'])}, is {shown(value)}"
        case "less_than_equal":
            return path, f"must be at most {_number(context['le'])}, is {shown(value)}"
        case "less_than":
            return path, f"must be less than {_number(context['lt'])}, is {shown(value)}"
        case "literal_error":
            return (
                path,
                f"must be {context['expected'].replace(chr(39), '')}, is {shown(value)}{_choice(value, context)}",
            )
        case "string_pattern_mismatch" if context["pattern"] == NAME_PATTERN:
            return path, f"must not hold a dot or a control character: {shown(value)}"
        case "string_too_short":
            return path, f"must have at least {context['min_length']} character"
        case "string_too_long":
            return path, f"must have at most {context['max_length']} characters, has {len(value)}"
        case "value_error":
            return path, str(context["error"])
        case "string_type" if path and path[-1] == "material":
            return path, f"must be the name of a material, is {_shown_with_hint(value)}"
        case "string_type" if type(value) in (int, float):
            return path, f'must be a string, is {shown(value)}; write it in quotes: "{value}"'
        case _ if kind in _EXPECTED:
            return path, f"must be {_EXPECTED[kind]}, is {_shown_with_hint(value)}"
        case _:
            return path, f"{details['msg']}: {shown(value)}"


_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "a string",
    "string_unicode": "valid Unicode",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
}


def _shown_with_hint(value: object) -> str:
    """A value of the wrong type, and what was probably meant by it."""
    if isinstance(value, str) and re.fullmatch(r"[-+]?\d+,\d+", value):
        return f"{shown(value)}; decimals have a point, not a comma"
    if isinstance(value, str) and value[:1] in tuple("\u201c\u201d\u2018\u2019"):
        return f"{shown(value)}; quotes are straight: \" or '"
    return shown(value)


def _choice(value: object, context: Mapping[str, Any]) -> str:
    names = re.findall("'([^']*)'", context["expected"])
    close = near_names(value, names, 1) if isinstance(value, str) else []
    return f"; did you mean {close[0]}?" if close else ""


def _number(limit: float) -> str:
    return str(limit) if isinstance(limit, int) else format(limit, ".15g")


def _pair(path: Path) -> str:
    if path[-1:] == ("size_m",):
        return "two numbers [width, height]"
    match path[-2:]:
        case ("amplitudes", int()):
            return "two numbers [speed, amplitude]"
        case ("intervals", _):
            return "two numbers [low, high]"
    return "two numbers [x, y]"


def _is_list(kind: object) -> bool:
    """Whether a type takes a list of any length."""
    return get_args(kind)[-1:] == (Ellipsis,)


def _user_path(model: type[Model] | None, details: ErrorDetails) -> tuple[Path, tuple[str, ...], object]:
    """Where the user sees the fault, the keys that are known there, and the type that is expected there.

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
            here = _bare(arguments[0 if _is_list(here) else -1]) if arguments else None
    return tuple(path), known, here


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
