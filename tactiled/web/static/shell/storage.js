/** What this browser keeps of the page's settings. @module */

/** @param {string} key @returns {string|null} null where nothing is kept, or the browser keeps nothing */
export function loadSetting(key) {
  try {
    return localStorage.getItem(key);
  } catch {
    return null;
  }
}

/**
 * Keep a setting, if the browser keeps anything: the page goes by it in any case.
 * @param {string} key
 * @param {string} value
 */
export function saveSetting(key, value) {
  try {
    localStorage.setItem(key, value);
  } catch {
    // As above.
  }
}
