// Paths as the daemon writes them in its errors and warnings, such as `materials.wood.tap.amplitudes[2]`.

// The keys and indices of a path; unusual keys are quoted.
export function parsePath(text) {
  const path = [];
  for (const [, index, quoted, plain] of text.matchAll(/\[(\d+)\]|("(?:[^"\\]|\\.)*")|([^.[\]]+)/g)) {
    path.push(index !== undefined ? Number(index) : quoted !== undefined ? JSON.parse(quoted) : plain);
  }
  return path;
}

// Returns whether one path is within the other.
export function related(a, b) {
  const length = Math.min(a.length, b.length);
  return a.slice(0, length).every((key, index) => key === b[index]);
}
