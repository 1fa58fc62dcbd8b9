// JSON Merge Patch (RFC 7396) on plain values: what a patch makes of a value, and the patch between two values.

export function isMap(value) {
  return value !== null && typeof value === "object" && !Array.isArray(value) && !ArrayBuffer.isView(value);
}

export function equal(a, b) {
  if (Array.isArray(a) && Array.isArray(b)) {
    return a.length === b.length && a.every((value, index) => equal(value, b[index]));
  }
  if (isMap(a) && isMap(b)) {
    const keys = Object.keys(a);
    return keys.length === Object.keys(b).length && keys.every((key) => Object.hasOwn(b, key) && equal(a[key], b[key]));
  }
  return Object.is(a, b) || (a === 0 && b === 0);
}

// What the patch makes of the value. Nothing that is given is changed.
export function merged(value, patch) {
  if (!isMap(patch)) {
    return patch;
  }
  const result = isMap(value) ? { ...value } : {};
  for (const [key, part] of Object.entries(patch)) {
    if (part === null) {
      delete result[key];
    } else {
      result[key] = merged(result[key], part);
    }
  }
  return result;
}

// The patch that makes `after` of `before`, both maps; {} where they are equal.
export function difference(before, after) {
  const patch = {};
  for (const key of Object.keys(before)) {
    if (!Object.hasOwn(after, key)) {
      patch[key] = null;
    }
  }
  for (const [key, value] of Object.entries(after)) {
    if (!Object.hasOwn(before, key)) {
      patch[key] = value;
    } else if (isMap(before[key]) && isMap(value)) {
      const part = difference(before[key], value);
      if (Object.keys(part).length) {
        patch[key] = part;
      }
    } else if (!equal(before[key], value)) {
      patch[key] = value;
    }
  }
  return patch;
}

// The patch that takes back what `patch` does to the map `before`.
export function inverse(before, patch) {
  return difference(merged(before, patch), before);
}

// One patch that does what `first` does, and then `second`; see canJoin.
export function joined(first, second) {
  if (!isMap(first) || !isMap(second)) {
    return second;
  }
  const result = { ...first };
  for (const [key, part] of Object.entries(second)) {
    result[key] = Object.hasOwn(result, key) ? joined(result[key], part) : part;
  }
  return result;
}

// Whether one patch can do what two do: not where the second goes into what the first removes or replaces.
export function canJoin(first, second) {
  return Object.entries(second).every(([key, part]) => !Object.hasOwn(first, key) || !isMap(part) || (isMap(first[key]) && canJoin(first[key], part)));
}

// [path, value] of everything that a patch sets; null: removed.
export function* leaves(patch, path = []) {
  if (isMap(patch) && Object.keys(patch).length) {
    for (const [key, part] of Object.entries(patch)) {
      yield* leaves(part, [...path, key]);
    }
  } else {
    yield [path, patch];
  }
}

// What lies at a path of keys and indices; undefined: nothing.
export function at(value, path) {
  return path.reduce((found, key) => (found !== null && typeof found === "object" ? found[key] : undefined), value);
}

// The patch that sets one path of keys.
export function patchAt(path, value) {
  return path.reduceRight((part, key) => ({ [key]: part }), value);
}

// Paths at which the value is not what a patch would have made of it.
export function departures(value, patch) {
  const found = [];
  for (const [path, wanted] of leaves(patch)) {
    const is = at(value, path);
    if (!(wanted === null ? is === undefined : equal(is, wanted) || (isMap(wanted) && isMap(is)))) {
      found.push({ path, is, wanted });
    }
  }
  return found;
}
