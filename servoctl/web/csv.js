// Files for download, made in the page: comma-separated, `#` lines first that say where the numbers come from.

/// Saves `columns` ({name: array}) under `name`; `notes` are lines of the head.
export function download(name, notes, columns) {
  const names = Object.keys(columns);
  const rows = names.length ? columns[names[0]].length : 0;
  const lines = [...notes.map((note) => `# ${note}`), names.join(",")];
  for (let row = 0; row < rows; row++) lines.push(names.map((column) => columns[column][row] ?? "").join(","));
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([lines.join("\n") + "\n"], { type: "text/csv" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
