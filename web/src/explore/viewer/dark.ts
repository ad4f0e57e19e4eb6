// Colours of what the lamp of the flight does not reach.
export const LUMEN_DARK = 0x2a0a14;
/** Beyond the ends of the lumen: as dark, but distinguishable in tests. */
export const OUTSIDE_DARK = 0x2a0a15;
