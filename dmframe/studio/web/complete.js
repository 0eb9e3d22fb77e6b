// Completion and descriptions of keys from the JSON Schema of graph files.
import { syntaxTree } from "./editor.min.js";

// The schema without references and alternatives that do not matter for completion; `mapping`: the values next to it.
function resolved(root, schema, mapping = {}) {
  for (let depth = 0; schema && depth < 8; depth++) {
    if (schema.$ref) { schema = schema.$ref.split("/").slice(1).reduce((place, key) => place?.[key], root); continue; }
    const chosen = schema.allOf?.find((each) => each.if && each.if.properties.type.const === mapping.type);
    if (chosen) { schema = chosen.then; continue; }
    const objects = schema.anyOf?.filter((each) => each.$ref || each.properties) ?? [];
    if (objects.length && !schema.properties) { schema = objects[0]; continue; }
    return schema;
  }
  return schema;
}

// Schema at a path of keys; `text`: the value of a key next to the last one, to find the type of a block.
export function schemaAt(root, path, typeOf) {
  let schema = resolved(root, root);
  for (let k = 0; k < path.length; k++) {
    const next = schema?.properties?.[path[k]] ?? (typeof schema?.additionalProperties === "object" ? schema.additionalProperties : undefined);
    schema = resolved(root, next, { type: typeOf(path.slice(0, k + 1)) });
  }
  return schema;
}

const keyText = (state, pair) => { const key = pair.getChild("Key"); return key ? state.sliceDoc(key.from, key.to).trim() : ""; };

// Keys from the document to the innermost mapping that contains a position, by the syntax tree.
export function pathAt(state, position) {
  const path = [];
  for (let node = syntaxTree(state).resolveInner(position, -1); node; node = node.parent) {
    const key = node.name === "Pair" && node.getChild("Key");
    if (key && position > key.to) path.unshift(keyText(state, node));
  }
  return path;
}

// The same by indentation, for a line that has only begun and is no part of the tree yet.
function pathByIndent(state, line) {
  const path = [];
  let least = line.text.search(/\S|$/);
  for (let number = line.number - 1; number > 0 && least > 0; number--) {
    const { text } = state.doc.line(number), found = text.match(/^(\s*)([\w.]+):\s*(#.*)?$/);
    if (!text.trim() || text.trim().startsWith("#")) continue;
    const indent = text.search(/\S/);
    if (indent < least) { least = indent; if (found) path.unshift(found[2]); else return null; }
  }
  return path;
}

// The `type` of the block at a path such as blocks, inverse.
export function typeReader(state) {
  return (path) => {
    if (path.length !== 2 || !["blocks", "baseline"].includes(path[0])) return undefined;
    const found = new RegExp(`^\\s+${path[1]}:[^\\S\\n]*\\{?\\s*(?:[^}]*?[\\s,{])?type:\\s*["']?([\\w.:]+)`, "m").exec(state.doc.toString());
    return found?.[1];
  };
}

const quoted = (value) => (/^[\w.-]+$/.test(value) ? value : `"${value}"`);

// Choices of a value.
function valuesOf(root, schema) {
  const found = new Set();
  const visit = (each, depth) => {
    if (!each || depth > 4) return;
    if (each.$ref) return visit(resolved(root, each), depth + 1);
    for (const value of each.enum ?? []) found.add(String(value));
    if (each.const !== undefined) found.add(String(each.const));
    if (each.type === "boolean") ["true", "false"].forEach((word) => found.add(word));
    for (const one of each.anyOf ?? []) visit(one, depth + 1);
  };
  visit(schema, 0);
  return [...found];
}

export function completions(root) {
  return (context) => {
    const { state, pos, explicit } = context, line = state.doc.lineAt(pos), before = line.text.slice(0, pos - line.from);
    if (/(^|\s)#/.test(before)) return null;
    const word = context.matchBefore(/[\w.]*/), typeOf = typeReader(state), begun = /^\s*[\w.]*$/.test(before);
    const value = /(^|[{,\s])([\w.]+):\s+["']?[\w.]*$/.exec(before);
    if (!explicit && (!word || word.from === word.to) && !value) return null;
    const path = begun ? pathByIndent(state, line) ?? pathAt(state, word.from) : pathAt(state, word.from);
    if (value) {
      if (path[path.length - 1] !== value[2]) path.push(value[2]);
      const parent = path.slice(0, -1), choices = path[2] === "type" || value[2] === "type"
        ? valuesOf(root, resolved(root, root).properties.blocks.additionalProperties.properties.type)
        : valuesOf(root, schemaAt(root, parent, typeOf)?.properties?.[value[2]]);
      return choices.length ? { from: word.from, options: choices.map((label) => ({ label, apply: quoted(label), type: "enum" })) } : null;
    }
    if (!begun && !/[{,]\s*[\w.]*$/.test(before)) return null;
    const properties = schemaAt(root, path, typeOf)?.properties;
    if (!properties) return null;
    return { from: word.from, options: Object.entries(properties).map(([label, { description }]) => ({ label, info: description, apply: `${label}: `, type: "property" })) };
  };
}

// Description of the key at a position.
export function described(root, state, position) {
  for (let node = syntaxTree(state).resolveInner(position, 1); node; node = node.parent) {
    if (node.name !== "Key" && node.parent?.name !== "Key") continue;
    const key = node.name === "Key" ? node : node.parent, name = state.sliceDoc(key.from, key.to).trim(), parent = pathAt(state, key.from);
    const schema = schemaAt(root, parent, typeReader(state)), own = schemaAt(root, [...parent, name], typeReader(state));
    const text = parent[0] === "blocks" && parent.length === 1 ? own?.properties?.type?.description : schema?.properties?.[name]?.description ?? own?.description;
    return text ? { from: key.from, to: key.to, text: `${name}: ${text}` } : null;
  }
  return null;
}
