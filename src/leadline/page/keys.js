// Keys do what the buttons do, but not while somebody writes or a dialog is open.
export function listen(keys, actions) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input") || document.querySelector("dialog[open]")) return;
    const name = keys[event.key.toLowerCase()];
    if (!name) return;
    event.preventDefault();
    actions[name]();
  });
}
