// The look of boxes on pages, in the 3D view and in the still picture. petmjx/show/pages/palette.py reads it, too,
// as JSON. Colours are sRGB from 0 to 1; `wall` is the opacity of a carrier's walls; `sunward` points to the sun;
// `view` is the first view of a page, radians.

export const LOOK = {
  "wood": [0.66, 0.52, 0.36],
  "wall": 0.1,
  "sunward": [-0.75, -0.5, 1.2],
  "view": { "azimuth": -0.65, "elevation": 0.4 }
};
