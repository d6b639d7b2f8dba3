// The look of boxes and of the ground on pages, in the 3D view and in the still picture. petmjx/show/pages/palette.py
// reads it, too, as JSON. Colours are sRGB from 0 to 1; `wall` is the opacity of a carrier's walls; `sunward` points to
// the sun; `view` is the first view of a page, radians; `shadowPixels` is the side of the map of shadows. `themes` are
// the colours of the ground and of its lines on light and dark pages, and the darkness of shadows.

export const LOOK = {
  "wood": [0.66, 0.52, 0.36],
  "wall": 0.1,
  "sunward": [-0.75, -0.5, 1.2],
  "view": { "azimuth": -0.65, "elevation": 0.4 },
  "shadowPixels": 2048,
  "themes": {
    "light": { "ground": [0.93, 0.935, 0.94], "ruled": [0.78, 0.79, 0.81], "shade": 0.3 },
    "dark": { "ground": [0.135, 0.145, 0.165], "ruled": [0.25, 0.27, 0.3], "shade": 0.6 }
  }
};
