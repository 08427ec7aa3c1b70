/**
 * Keyboard shortcuts.
 * @module
 */

/**
 * Call an action for each key that names one; keys meant for a field, a button or a dialog stay theirs.
 * @param {Record<string, (event: KeyboardEvent) => void>} actions by `event.key`, letters in lower case
 */
export function keys(actions) {
  document.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || document.querySelector("dialog[open]")) return;
    const target = event.target instanceof Element ? event.target : null;
    if (target?.closest("input:not([type=checkbox]), select, textarea") && event.key !== "Escape") return;
    if (event.key === " " && target?.closest("button, input, a")) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
  // A button keeps the focus of a click: give it back, or the next space would press the button again.
  document.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    if (button && event.detail > 0 && !button.closest("dialog")) button.blur();
  });
}
