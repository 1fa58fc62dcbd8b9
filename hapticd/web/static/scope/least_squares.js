// Linear least squares with a few unknowns, by Householder reflections, which overwrite the columns and the right side.

// Returns the x that minimizes |columns x - right|, as an array; null if the columns are linearly dependent.
export function leastSquares(columns, right) {
  const n = columns.length;
  const rows = right.length;
  const diagonal = new Float64Array(n);
  for (let j = 0; j < n; j++) {
    const column = columns[j];
    let norm = 0;
    for (let i = j; i < rows; i++) {
      norm += column[i] * column[i];
    }
    norm = Math.sqrt(norm);
    if (!(norm > 0)) {
      return null;
    }
    diagonal[j] = column[j] > 0 ? -norm : norm;
    column[j] -= diagonal[j];
    const square = norm * norm + Math.abs(diagonal[j] * (column[j] + diagonal[j])); // half of |v|^2
    for (let k = j + 1; k < n; k++) {
      reflect(column, columns[k], j, rows, square);
    }
    reflect(column, right, j, rows, square);
  }
  const x = new Array(n);
  let greatest = 0;
  for (let j = 0; j < n; j++) {
    greatest = Math.max(greatest, Math.abs(diagonal[j]));
  }
  for (let j = n - 1; j >= 0; j--) {
    if (!(Math.abs(diagonal[j]) > 1e-13 * greatest)) {
      return null;
    }
    let sum = right[j];
    for (let k = j + 1; k < n; k++) {
      sum -= columns[k][j] * x[k];
    }
    x[j] = sum / diagonal[j];
  }
  return x;
}

function reflect(v, target, from, rows, halfSquare) {
  let dot = 0;
  for (let i = from; i < rows; i++) {
    dot += v[i] * target[i];
  }
  const factor = dot / halfSquare;
  for (let i = from; i < rows; i++) {
    target[i] -= factor * v[i];
  }
}

// Returns the roots of x^n + c[n-1] x^(n-1) + ... + c[0] as [re, im] (Durand and Kerner).
export function roots(coefficients) {
  const n = coefficients.length;
  let radius = 0;
  for (const c of coefficients) {
    radius = Math.max(radius, Math.abs(c));
  }
  radius = Math.min(1 + radius, 2);
  const found = Array.from({ length: n }, (_, k) => {
    const angle = (2 * Math.PI * (k + 0.35)) / n;
    return [radius * 0.7 * Math.cos(angle), radius * 0.7 * Math.sin(angle)];
  });
  for (let round = 0; round < 500; round++) {
    let moved = 0;
    for (let k = 0; k < n; k++) {
      const [re, im] = found[k];
      let [pr, pi] = [1, 0];
      for (let c = n - 1; c >= 0; c--) {
        [pr, pi] = [pr * re - pi * im + coefficients[c], pr * im + pi * re];
      }
      let [qr, qi] = [1, 0];
      for (let other = 0; other < n; other++) {
        if (other !== k) {
          const [dr, di] = [re - found[other][0], im - found[other][1]];
          [qr, qi] = [qr * dr - qi * di, qr * di + qi * dr];
        }
      }
      const square = qr * qr + qi * qi || 1e-300;
      const [sr, si] = [(pr * qr + pi * qi) / square, (pi * qr - pr * qi) / square];
      found[k] = [re - sr, im - si];
      moved = Math.max(moved, Math.abs(sr) + Math.abs(si));
    }
    if (moved < 1e-15) {
      break;
    }
  }
  return found;
}
