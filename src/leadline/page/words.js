// Numbers and states in words.
export const STAGES = ["Searching", "Cameras", "Cameras + laser", "Laser, near"];
export const STAGE_WORDS = [
  "Looking for the target.",
  "Far away: the two cameras measure alone.",
  "Cameras and laser measure together.",
  "So near that the laser leads; the cameras help with what they still see.",
];
export const STATUS_WORDS = {
  valid: "✓ Position good", coasting: "! Nothing measured just now: predicted", lost: "✕ Target not found", none: "Waiting for the first image",
};
const PARTS = { left: "Left camera", right: "Right camera", laser: "Laser", detector: "Detector", clock: "Clock", disk: "Disk", output: "Outputs" };
export const partName = (part) => PARTS[part] ?? part;

export function metres(value) {
  if (value == null) return "–";
  return value < 10 ? value.toFixed(3) : value.toFixed(2);
}

export function small(value) { // an uncertainty, m
  if (value == null) return "–";
  if (value < 0.01) return `${(value * 1e3).toFixed(1)} mm`;
  return value < 1 ? `${(value * 100).toFixed(1)} cm` : `${value.toFixed(2)} m`;
}

export const length = (value) => (value < 1 ? `${+(value * 100).toFixed(1)} cm` : `${+value.toFixed(2)} m`);

export function turn(degrees, positive, negative) {
  const size = Math.abs(degrees);
  return size < 1 ? "straight" : `${size.toFixed(0)}° ${degrees > 0 ? positive : negative}`;
}

export function closing(value) {
  if (value == null) return "–";
  if (Math.abs(value) < 0.005) return "holding";
  return `${value < 0 ? "−" : ""}${Math.abs(value).toFixed(2)} m/s`;
}

export function standoff(seconds) {
  if (seconds == null) return "–";
  return seconds === 0 ? "✓ there" : seconds > 99 ? "> 99 s" : `${seconds.toFixed(seconds < 10 ? 1 : 0)} s`;
}

export function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(1).padStart(4, "0")}`;
}
