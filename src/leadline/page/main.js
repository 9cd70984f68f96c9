// The page: takes what the server says, shows it, and passes on what its user wants.
import { Curves } from "/curves.js";
import { listen } from "/keys.js";
import { Link } from "/link.js";
import { Map2 } from "/maps.js";
import { drawPictures, overlay } from "/pictures.js";
import { show, showConnection, showHello, showRates } from "/show.js";
import { startTheme, toggleTheme } from "/theme.js";

const byId = (id) => document.getElementById(id);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const canvases = { left: byId("left"), right: byId("right") };
const SLOW_MS = 180; // between two drawings of curves and maps: they say nothing new faster

startTheme();
const curves = new Curves(byId("plot"), colour);
const maps = [new Map2(byId("above"), "above", colour), new Map2(byId("side"), "side", colour)];
let hello = null, desk = {}, drawn = 0, shown = Promise.resolve();

const link = new Link({
  state: (state) => showConnection(state),
  message: (head, blobs) => { shown = shown.then(() => take(head, blobs)).catch((error) => console.error(error)); },
});

async function take(head, blobs) {
  if (!link.isOpen) return; // came just before the connection was lost
  if (head.kind === "hello") {
    hello = head;
    showHello(hello);
    curves.reset();
    maps.forEach((map) => map.reset(hello));
  } else {
    showConnection("open", head);
    if (head.kind === "news") {
      desk = head.desk;
      show(head, hello);
      curves.add(head.rows, head.readings);
      maps.forEach((map) => map.add(head.rows));
    }
    if (blobs.length) {
      const paint = (pen, side, scale) => overlay(pen, side, head.scene, hello.beam, scale);
      await drawPictures(canvases, blobs, hello.size, paint);
    }
    if (performance.now() - drawn > SLOW_MS) redraw();
  }
  showRates(head);
  link.say({ shown: head.n });
}

function redraw() {
  drawn = performance.now();
  curves.draw();
  maps.forEach((map) => map.draw());
}

const actions = {
  record: () => link.say({ do: desk.recording ? "stop" : "record" }),
  mark: () => { byId("mark_text").value = ""; byId("mark_dialog").showModal(); },
  download: () => byId("download").click(),
  theme: () => {
    toggleTheme();
    curves.build();
    redraw();
  },
  help: () => byId("help_dialog").showModal(),
};
const KEYS = { r: "record", m: "mark", d: "download", t: "theme", "?": "help" };

for (const name of ["record", "mark", "theme", "help"]) byId(name).addEventListener("click", actions[name]);
byId("mark_cancel").addEventListener("click", () => byId("mark_dialog").close("cancel"));
byId("mark_dialog").addEventListener("close", () => {
  if (byId("mark_dialog").returnValue === "mark") link.say({ do: "mark", text: byId("mark_text").value });
  byId("mark_dialog").returnValue = "";
});
listen(KEYS, actions);
setInterval(() => hello && redraw(), 1000); // the last message's curve too
