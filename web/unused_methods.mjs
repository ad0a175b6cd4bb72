// Drops functions of classes and closures that nothing in a bundle names. A bundler keeps each method of a class that is used,
// and each function of a closure; of three.js the page needs a part of them.
const IMPLICIT = new Set(["constructor", "toString", "valueOf", "then", "next", "return"]); // called without their name

/** Definitions, as esbuild prints them: methods, members that a constructor sets, and functions within functions. */
const DEFINITIONS = [
  /^ {2}(?:static |async |get |set )*([A-Za-z_$][\w$]*)\([^\n]*\) \{\n(?:[^\n]*\n)*?^ {2}\}\n/gm,
  /^ {4}this\.([A-Za-z_$][\w$]*) = function\([^\n]*\) \{\n(?:[^\n]*\n)*?^ {4}\};\n/gm,
  /^( {2,})(?:async )?function ([A-Za-z_$][\w$]*)\([^\n]*\) \{\n(?:[^\n]*\n)*?^\1\}\n/gm,
];
/** What a closure returns, and one of the lines that hand out a function under its own name. */
const RETURNED = /^( +)return \{\n(?:\1 [^\n]*\n)*?\1\};\n/gm;
const HANDED_OUT = /^ +([A-Za-z_$][\w$]*)(?:: \1)?,?\n/gm;
const NAME = /[A-Za-z_$][\w$]*/g;

function namesOf(code) {
  const counts = new Map();
  for (const [name] of code.matchAll(NAME)) counts.set(name, (counts.get(name) ?? 0) + 1);
  return counts;
}

/** The parts of a bundle that define or hand out a function, as [start, text, name], in the order of the bundle. */
function definitions(code) {
  const found = DEFINITIONS.flatMap((pattern) => [...code.matchAll(pattern)].map((match) => [match.index, match[0], match.at(-1)]));
  for (const { index, 0: block } of code.matchAll(RETURNED))
    for (const match of block.matchAll(HANDED_OUT)) found.push([index + match.index, match[0], match[1]]);
  return found.sort((a, b) => a[0] - b[0]);
}

/** How often the definitions of each name name it themselves; one that lies within another of its name counts once. */
function ownNames(code) {
  const [counts, ends] = [new Map(), new Map()];
  for (const [start, text, name] of definitions(code)) {
    if (start < (ends.get(name) ?? 0)) continue;
    ends.set(name, start + text.length);
    counts.set(name, (counts.get(name) ?? 0) + namesOf(text).get(name));
  }
  return counts;
}

/** A bundle that is not minified, without these functions; what only they name is dropped, too. */
export function withoutUnusedMethods(code) {
  for (;;) {
    const all = namesOf(code);
    const own = ownNames(code);
    const isUnused = (name) => !IMPLICIT.has(name) && own.get(name) === all.get(name);
    const without = (text, ...groups) => (isUnused(groups.at(-3)) ? "" : text); // the last group, an index and the bundle
    let less = code.replaceAll(RETURNED, (block) => block.replaceAll(HANDED_OUT, (text, name) => (isUnused(name) ? "" : text)));
    for (const pattern of DEFINITIONS) less = less.replaceAll(pattern, without);
    if (less === code) return code;
    code = less;
  }
}
