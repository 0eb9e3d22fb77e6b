// Source of editor.min.js: CodeMirror 6 with YAML, completion, faults and hovers. It is built in an empty folder with the
// versions of editor.licences.txt by
//   npm install esbuild@0.28.2 @codemirror/lang-yaml@6.1.3 @codemirror/autocomplete@6.20.4 @codemirror/lint@6.9.8 ...
//   npx esbuild editor.js --bundle --minify --format=esm --target=es2022 --legal-comments=none --outfile=editor.min.js
export { EditorState, StateEffect, StateField, Annotation } from "@codemirror/state";
export { EditorView, Decoration, keymap, lineNumbers, highlightActiveLine, drawSelection, hoverTooltip } from "@codemirror/view";
export { defaultKeymap, history, historyKeymap, indentWithTab } from "@codemirror/commands";
export { bracketMatching, syntaxHighlighting, defaultHighlightStyle, syntaxTree, indentUnit } from "@codemirror/language";
export { autocompletion, closeBrackets, closeBracketsKeymap, completionKeymap } from "@codemirror/autocomplete";
export { setDiagnostics, lintGutter } from "@codemirror/lint";
export { yaml } from "@codemirror/lang-yaml";
