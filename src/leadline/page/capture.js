// The page of a guided capture: what to do next, what is thought of the picture, what is still missing.
import { beep, drawPose, paintLook } from "/capture_draw.js";
import { Connection } from "/connection.js";
import { listen } from "/keys.js";
import { Link } from "/link.js";
import { drawPictures } from "/pictures.js";
import { startTheme, toggleTheme } from "/theme.js";

const byId = (id) => document.getElementById(id);
const put = (id, words) => { const place = byId(id); if (place.textContent !== words) place.textContent = words; };
const make = (tag, words, kind = "") => Object.assign(document.createElement(tag), { textContent: words, className: kind });
const canvases = { left: byId("left"), right: byId("right") };
const SIGNS = { bad: "✕", wait: "…", same: "=", saved: "✓", none: "…" };
const SAVED_MS = 1200; // that a saved picture is shown as such

startTheme();
const connection = new Connection(["Ended", ""]);
let hello = null, size = null, status = null, told = null, savedUntil = 0, sound = false, shown = Promise.resolve();

const link = new Link({
  state: (state) => connection.show(state, {}),
  message: (head, blobs) => { shown = shown.then(() => take(head, blobs)).catch((error) => console.error(error)); },
});

async function take(head, blobs) {
  if (!link.isOpen) return; // came just before the connection was lost
  if (head.kind === "hello") showHello(head);
  else {
    connection.show("open", head);
    if (head.kind === "news") showNews(head);
    if (blobs.length && size) {
      await drawPictures(canvases, blobs, size, (pen, side, scale) => paintLook(pen, side, head.scene, scale));
    }
  }
  link.say({ shown: head.n });
}

function showHello(head) {
  hello = head;
  told = null;
  const board = hello.what === "board";
  put("source", `${hello.aim} · ${hello.name}`);
  put("coverage_title", board ? "Where the board has been" : "Where the target has been");
  byId("cells_right").parentElement.hidden = !board;
  byId("keep").hidden = board;
  for (const place of document.querySelectorAll(".keep")) place.hidden = board;
  byId("pose").hidden = !board;
  document.querySelector(".legend .goal").hidden = !board;
}

function showNews(head) {
  size = head.size ?? size;
  if (told !== null && head.told[0] > told) tell(head.told[1]);
  told = head.told[0];
  if (head.look) showLook(...head.look);
  if (head.status) showStatus(head.status);
}

function tell(words) {
  put("told", words);
  if (!words.startsWith("Saved")) return;
  savedUntil = performance.now() + SAVED_MS;
  put("saved_words", words.replace(/^Saved: |\.$/g, ""));
  byId("saved").hidden = false;
  byId("pictures").classList.add("flash");
  if (sound) beep();
  setTimeout(() => {
    if (performance.now() < savedUntil - 50) return;
    byId("saved").hidden = true;
    byId("pictures").classList.remove("flash");
  }, SAVED_MS);
}

function showLook(state, words) {
  if (performance.now() < savedUntil && state !== "saved") return; // it would be gone before it is read
  put("now_words", words);
  byId("now").dataset.state = state;
  byId("now").querySelector(".sign").textContent = SIGNS[state];
}

function showStatus(news) {
  status = news;
  put("next", status.next);
  byId("todo").dataset.enough = status.enough;
  drawPose(byId("pose"), status.tilt, status.enough);
  put("count", `${status.count}`);
  put("want", `${status.want}`);
  byId("share").value = status.share;
  put("quality", status.quality);
  for (const [side, rows] of Object.entries(status.cells)) showCells(byId(`cells_${side}`), side, rows);
  showLists(status.lists);
}

function showCells(grid, side, rows) {
  const said = JSON.stringify(rows);
  if (grid.dataset.said === said) return;
  grid.dataset.said = said;
  grid.style.setProperty("--columns", rows[0].length);
  const cells = rows.flat();
  const done = cells.filter((cell) => cell === "yes").length;
  grid.setAttribute("aria-label", `${side} picture: ${done} of ${cells.filter((cell) => cell !== "idle").length} fields done`);
  grid.replaceChildren(...cells.map((cell) => make("i", cell === "yes" ? "✓" : "", cell)));
}

function showLists(lists) {
  const said = JSON.stringify(lists);
  if (byId("lists").dataset.said === said) return;
  byId("lists").dataset.said = said;
  byId("lists").replaceChildren(...Object.entries(lists).map(([title, lines]) => {
    const part = make("div", "");
    const list = make("ul", "");
    list.append(...lines.map(({ name, have, want }) => {
      const line = make("li", "", have >= want ? "done" : "");
      const pips = make("span", "■".repeat(Math.min(have, want)) + "□".repeat(Math.max(want - have, 0)), "pips");
      pips.setAttribute("aria-label", `${Math.min(have, want)} of ${want}`);
      line.append(make("span", `${have >= want ? "✓" : "○"} ${name}`), pips);
      return line;
    }));
    part.append(make("h2", title), list);
    return part;
  }));
}

function askEnd() {
  const missing = status?.missing ?? [];
  put("end_title", status?.enough ? "End now?" : "It is not enough yet. End all the same?");
  put("end_words", status?.enough ? "It is enough." : "What is saved stays, and the same command goes on with it. Still missing:");
  byId("end_missing").replaceChildren(...missing.map((one) => make("li", `○ ${one}`)));
  byId("end_dialog").showModal();
}

const actions = {
  undo: () => link.say({ do: "undo" }),
  keep: () => hello?.what === "target" && link.say({ do: "keep" }),
  end: askEnd,
  sound: () => {
    sound = !sound;
    byId("sound").setAttribute("aria-pressed", sound);
    if (sound) beep(); // a browser wants to have been asked for it
  },
  theme: () => { toggleTheme(); drawPose(byId("pose"), status?.tilt ?? "", status?.enough ?? false); },
  help: () => byId("help_dialog").showModal(),
};
const KEYS = { u: "undo", s: "keep", e: "end", b: "sound", t: "theme", "?": "help" };

for (const name of Object.keys(actions)) byId(name).addEventListener("click", actions[name]);
byId("end_dialog").addEventListener("close", () => {
  if (byId("end_dialog").returnValue === "end") link.say({ do: "end" });
  byId("end_dialog").returnValue = "";
});
listen(KEYS, actions);
