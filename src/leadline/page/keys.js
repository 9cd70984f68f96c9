// Keys do what the buttons do, but not while somebody writes or a dialog is open. What was just closed with Escape may
// hold the focus until the page is drawn again: nobody writes there.
const isWritten = (element) => element.matches("input") && !element.closest("dialog:not([open])");

export function listen(keys, actions) {
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || isWritten(event.target) || document.querySelector("dialog[open]")) return;
    const name = keys[event.key.toLowerCase()];
    if (!name) return;
    event.preventDefault();
    actions[name]();
  });
}
