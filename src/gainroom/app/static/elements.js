// Elements of the page: found by their id, and made.
// @ts-check

/** @param {string} id @returns {any} */
export const by = (id) => document.getElementById(id);

/** @param {string} tag @param {any} [properties] @param {...(string | Node)} children @returns {any} */
export function made(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}
