// The way to the server: one websocket, opened again whenever it is lost.
const AGAIN_MS = 1000, SILENT_MS = 4000, KEPT = 20;

export class Link {
  // on.state("open" | "lost" | "refused"), on.message(head, blobs)
  constructor(on) {
    this.on = on;
    this.unsaid = []; // while the way is lost
    this.open();
    setInterval(() => this.watch(), 500);
  }

  open() {
    this.heard = performance.now();
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = (event) => this.take(event.data);
    socket.onclose = () => this.lost(socket);
    socket.onopen = () => this.unsaid.splice(0).forEach((words) => this.say(words));
    this.socket = socket;
  }

  watch() { // a cable that is pulled closes nothing
    if (this.socket && performance.now() - this.heard > SILENT_MS) this.lost(this.socket);
  }

  lost(socket) {
    if (socket !== this.socket) return;
    this.socket = null;
    socket.onclose = socket.onmessage = socket.onopen = null;
    socket.close();
    this.on.state("lost");
    this.retry();
  }

  async retry() {
    await new Promise((done) => setTimeout(done, AGAIN_MS));
    try {
      const answer = await fetch("/alive", { signal: AbortSignal.timeout(SILENT_MS) });
      if (answer.ok) return this.open();
      this.on.state(answer.status === 401 ? "refused" : "lost");
    } catch {
      this.on.state("lost"); // not there yet
    }
    this.retry();
  }

  take(data) {
    this.heard = performance.now();
    const size = new DataView(data).getUint32(0);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, size)));
    let at = 4 + size;
    const blobs = [];
    for (const length of head.bytes) {
      blobs.push(new Blob([new Uint8Array(data, at, length)], { type: "image/jpeg" }));
      at += length;
    }
    this.on.message(head, blobs);
  }

  get isOpen() {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  say(words) {
    if (this.isOpen) this.socket.send(JSON.stringify(words));
    else if (words.do && this.unsaid.length < KEPT) this.unsaid.push(words);
  }
}
