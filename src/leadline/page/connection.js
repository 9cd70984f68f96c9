// Whether what is seen is live, old or at its end.
const byId = (id) => document.getElementById(id);
const put = (id, words) => { const place = byId(id); if (place.textContent !== words) place.textContent = words; };

export class Connection {
  constructor([endTitle, endWords]) {
    this.endTitle = endTitle;
    this.endWords = endWords;
    this.ended = null;
  }

  show(state, head, trouble = "") {
    if (head.ended !== undefined) this.ended = head.ended;
    if (state !== "open") this.ended = null;
    const silent = head.silent_s > 2.5;
    const words = {
      lost: ["Connection lost", "Connection lost: what you see is old. Trying again every second…"],
      refused: ["Token refused", "The server asks for its token: open the address that leadline has printed."],
      ended: [this.endTitle, [this.endWords, ...(this.ended ?? [])].join(" ")],
      silent: ["No data", `No sensor has said anything for ${Math.round(head.silent_s)} s. Are the devices connected?`],
      open: ["Live", trouble],
    };
    const now = state !== "open" ? state : this.ended ? "ended" : silent ? "silent" : "open";
    put("link", words[now][0]);
    byId("link").dataset.state = now;
    put("banner", words[now][1]);
    byId("banner").hidden = !words[now][1];
    byId("banner").dataset.state = now;
    document.body.classList.toggle("old", state !== "open");
  }
}
