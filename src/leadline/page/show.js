// Words and numbers of the page.
import { STAGES, STAGE_WORDS, STATUS_WORDS, clock, closing, length, metres, partName, small, standoff, turn } from "/words.js";

import { Connection } from "/connection.js";

const byId = (id) => document.getElementById(id);
const put = (id, words) => { const place = byId(id); if (place.textContent !== words) place.textContent = words; };
const make = (tag, words, kind = "") => Object.assign(document.createElement(tag), { textContent: words, className: kind });

export function showHello(hello) {
  const { safety_m, standoff_m, reach_m, accuracy_m } = hello.limits;
  put("source", `${hello.name}, target ${hello.target}`);
  for (const [name, metres] of [["safety", safety_m], ["standoff", standoff_m], ["reach", reach_m]]) {
    const words = { safety: "alarm", standoff: "stand-off", reach: "reach" }[name];
    document.querySelector(`#maps .${name}`).textContent = `${words} ${length(metres)}`;
  }
  put("standoff_limit", `until ${length(standoff_m)}`);
  put("reach_limit", `of ${length(reach_m)}`);
  put("accurate_limit", `to ${length(accuracy_m)}`);
  byId("stages").replaceChildren(...STAGES.map((name, stage) => make("li", `${stage} ${name}`, `stage${stage}`)));
  byId("events").replaceChildren(make("li", "none yet; M marks one", "small"));
  document.querySelector(".truth").hidden = true;
  for (const name of ["beam", "spot"]) document.querySelector(`.legend .${name}`).hidden = !hello.beam;
  last = { row: null, frames: null };
}

let last = { row: null, frames: null };

export function show(news, hello) {
  const row = news.rows.at(-1) ?? last.row;
  last.row = row;
  if (row) showRow(row, hello);
  if (row?.[3] != null) document.querySelector(".truth").hidden = false;
  showGuidance(news.guidance, hello);
  showHealth(news.health);
  showDesk(news.desk, news.events);
}

function showRow([, stage, statusAt, , range, sigma], hello) {
  const status = hello.statuses[statusAt];
  put("range", metres(range));
  put("sigma", sigma == null ? "–" : small(2 * sigma));
  put("status", STATUS_WORDS[status]);
  byId("status").dataset.state = status;
  put("stage_words", STAGE_WORDS[stage]);
  [...byId("stages").children].forEach((item, i) => {
    if (i === stage) item.setAttribute("aria-current", "true");
    else item.removeAttribute("aria-current");
  });
}

function showGuidance(told, hello) {
  put("turn", told ? turn(told.bearing_deg, "◀ left", "right ▶") : "–");
  put("tilt", told ? turn(told.elevation_deg, "▲ up", "▼ down") : "–");
  put("closing", told ? closing(told.closing_m_s) : "–");
  put("standoff", told ? standoff(told.standoff_s) : "–");
  for (const [id, yes] of [["reach", told?.in_reach], ["accurate", told?.accurate]]) {
    put(id, yes == null ? "–" : yes ? "✓ yes" : "✕ no");
    byId(id).dataset.yes = yes ?? "";
  }
  const alarm = byId("alarm");
  alarm.hidden = !told?.alarm;
  put("alarm", told?.alarm ? `Too near: less than ${length(hello.limits.safety_m)}` : "");
}

function showHealth(parts) {
  const said = JSON.stringify(parts.map(({ part, state, why }) => [part, state, why]));
  if (byId("parts").dataset.said === said) return;
  byId("parts").dataset.said = said;
  const sorted = [...parts].sort((a, b) => (a.state === "ok") - (b.state === "ok"));
  byId("parts").replaceChildren(...sorted.map(({ part, state, why, advice }) => {
    if (state === "ok") return make("li", `✓ ${partName(part)}`, "ok");
    const item = make("li", "", "fault");
    item.append(make("strong", `! ${partName(part)}: ${state}. `), make("span", `${why}. `), make("em", `What to do: ${advice}.`));
    return item;
  }));
}

function showDesk(desk, events) {
  const button = byId("record"), on = Boolean(desk.recording);
  button.setAttribute("aria-pressed", on);
  const words = on ? "Stop recording" : "Record";
  if (button.querySelector(".word").textContent !== words) button.querySelector(".word").textContent = words;
  if (events.length) byId("events").querySelector(".small")?.remove();
  for (const [t, text] of events) byId("events").prepend(make("li", `${clock(t)}  ${text}`));
  while (byId("events").children.length > 50) byId("events").lastChild.remove();
  trouble = desk.trouble;
}

let trouble = "";
const connection = new Connection(["Dive ended", "The dive has ended."]);
export const showConnection = (state, head = {}) => connection.show(state, head, trouble);

let counted = { since: performance.now(), messages: 0, frames: null };

export function showRates({ frames }) {
  counted.messages += 1;
  counted.frames ??= frames ?? null;
  const passed = (performance.now() - counted.since) / 1000;
  if (passed < 1) return;
  const rate = (counted.messages / passed).toFixed(0);
  const seen = frames == null || counted.frames == null ? "" : `${((frames - counted.frames) / passed).toFixed(0)} stereo frames a second · `;
  put("rates", `${seen}page drawn ${rate} times a second`);
  byId("rates").dataset.rate = counted.messages / passed;
  counted = { since: performance.now(), messages: 0, frames: frames ?? null };
}
