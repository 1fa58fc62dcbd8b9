// JSON Merge Patch (RFC 7396) on plain values: applying a patch, and computing the patch between two values.

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

// Returns the patched value. The arguments are not changed.
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

// Returns the patch from map `before` to map `after`; {} if they are equal.
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

// Returns the patch that undoes `patch` of the map `before`.
export function inverse(before, patch) {
  return difference(merged(before, patch), before);
}

// Returns one patch for `first` followed by `second`; see canJoin.
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

// Returns whether two patches can be joined: not if the second changes a member of what the first removes or replaces.
export function canJoin(first, second) {
  return Object.entries(second).every(([key, part]) => !Object.hasOwn(first, key) || !isMap(part) || (isMap(first[key]) && canJoin(first[key], part)));
}

// Returns [path, value] of all values that a patch sets; null: removed.
export function* leaves(patch, path = []) {
  if (isMap(patch) && Object.keys(patch).length) {
    for (const [key, part] of Object.entries(patch)) {
      yield* leaves(part, [...path, key]);
    }
  } else {
    yield [path, patch];
  }
}

// Returns the value at a path of keys and indices, or undefined.
export function at(value, path) {
  return path.reduce((found, key) => (found !== null && typeof found === "object" ? found[key] : undefined), value);
}

// Returns the patch that sets one path of keys.
export function patchAt(path, value) {
  return path.reduceRight((part, key) => ({ [key]: part }), value);
}

// Returns the paths at which a value differs from what a patch sets.
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
