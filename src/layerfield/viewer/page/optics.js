// Where the light paths of an eye meet the layers: the formulas of geometry.py.

const WHOLE = 1e-6; // shifts closer to a whole pixel than this are whole

// The magnification and the shift, in pixels, of every layer, for an eye whose slope is
// (X / Z, Y / Z) at the distance Z: the path through x meets layer k at m_k x + d_k, x counted
// from the centre.
export function paths(display, [x, y], distance) {
  return display.depths.map((depth, k) => ({
    magnification: (1 - depth / distance) / display.scales[k],
    x: snapped(x * display.parallax[k]),
    y: snapped(y * display.parallax[k]),
  }));
}

export function distanceOf(display) {
  return display.distance ?? Infinity;
}

function snapped(shift) {
  const whole = Math.round(shift);
  return Math.abs(shift - whole) < WHOLE ? whole : shift;
}

// The viewpoint nearest to an eye, by its slope.
export function nearestView(display, [x, y]) {
  const far = display.slopes.map(([u, v]) => (u - x) ** 2 + (v - y) ** 2);
  return far.indexOf(Math.min(...far));
}

// The box of slopes that holds all viewpoints: its centre and half its width and height.
export function extent(display) {
  const [xs, ys] = [0, 1].map((axis) => display.slopes.map((slope) => slope[axis]));
  const middle = (values) => (Math.max(...values) + Math.min(...values)) / 2;
  const half = (values) => (Math.max(...values) - Math.min(...values)) / 2;
  return { centre: [middle(xs), middle(ys)], half: [half(xs), half(ys)] };
}
