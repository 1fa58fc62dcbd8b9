// Paths as the daemon writes them in its errors and warnings, such as `materials.wood.tap.amplitudes[2]`.

// The keys and indices of a path; an odd key stands in quotes there.
export function parsePath(text) {
  const path = [];
  for (const [, index, quoted, plain] of text.matchAll(/\[(\d+)\]|("(?:[^"\\]|\\.)*")|([^.[\]]+)/g)) {
    path.push(index !== undefined ? Number(index) : quoted !== undefined ? JSON.parse(quoted) : plain);
  }
  return path;
}

// Whether one path lies in the other.
export function related(a, b) {
  const length = Math.min(a.length, b.length);
  return a.slice(0, length).every((key, index) => key === b[index]);
}
