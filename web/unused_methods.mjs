// Drops methods of classes that nothing in a bundle names. A bundler keeps each method of a class that is used; of three.js the
// page needs a part of them.
const IMPLICIT = new Set(["constructor", "toString", "valueOf", "then", "next", "return"]); // called without their name
const METHOD = /^ {2}(?:static |async )*([A-Za-z_$][\w$]*)\([^\n]*\) \{\n(?:[^\n]*\n)*?^ {2}\}\n/gm; // as esbuild prints it
const NAME = /[A-Za-z_$][\w$]*/g;

function namesOf(code) {
  const counts = new Map();
  for (const [name] of code.matchAll(NAME)) counts.set(name, (counts.get(name) ?? 0) + 1);
  return counts;
}

/** A bundle that is not minified, without these methods; what only they name is dropped, too. */
export function withoutUnusedMethods(code) {
  for (;;) {
    const all = namesOf(code);
    const own = new Map(); // how often the methods of a name name it themselves
    for (const [text, name] of code.matchAll(METHOD)) own.set(name, (own.get(name) ?? 0) + namesOf(text).get(name));
    const unused = (name) => !IMPLICIT.has(name) && own.get(name) === all.get(name);
    const less = code.replaceAll(METHOD, (text, name) => (unused(name) ? "" : text));
    if (less === code) return code;
    code = less;
  }
}
