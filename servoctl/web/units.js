// Quantities as people read and type them: `1.5 mm`, `100mm/s`, `50 nm`.

const SIZES = {
  "m": 1, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9,
  "m/s": 1, "mm/s": 1e-3, "µm/s": 1e-6,
  "m/s²": 1, "mm/s²": 1e-3,
  "m/s³": 1, "mm/s³": 1e-3,
  "N": 1, "mN": 1e-3,
};

/// Reads a number with a unit of the dimension of `unit` ("m", "m/s", …); returns it in that unit, or throws what is wrong.
export function parse(text, unit) {
  const dimension = (name) => name.replace(/^[mµn](?=[mN])/, "");
  const match = /^\s*([+-−]?[0-9.,]+(?:e[+-]?\d+)?)\s*(\D.*)?$/i.exec(text);
  const number = match ? Number(match[1].replace("−", "-").replace(",", ".")) : NaN;
  const typed = (match?.[2] ?? "").trim().replace(/^[uμ]/, "µ").replace(/\^?2$/, "²").replace(/\^?3$/, "³");
  if (!Number.isFinite(number)) throw new Error(`“${text}” is no number with a unit of ${unit}`);
  if (!(typed in SIZES) || dimension(typed) !== unit) throw new Error(`“${text}”: the unit must be one of ${known(unit)}`);
  return number * SIZES[typed];

  function known(unit) {
    return Object.keys(SIZES).filter((name) => dimension(name) === unit).join(", ");
  }
}

/// The unit that suits lengths of this size: its name and its size in m.
export function lengthUnit(size_m) {
  const size = Math.abs(size_m);
  if (size < 0.9999e-6) return ["nm", 1e-9];
  if (size < 0.9999e-3) return ["µm", 1e-6];
  return ["mm", 1e-3];
}

/// A length in the unit that suits it.
export function length(value_m) {
  const [unit, size] = lengthUnit(value_m);
  return `${fixed(value_m / size, { nm: 1, µm: 3, mm: 6 }[unit])} ${unit}`;
}

/// A number with so many decimals and a proper minus; a dash for none.
export function fixed(value, decimals) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const text = value.toFixed(decimals);
  return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "−");
}

/// A length of which only the digits that count are shown: `5 mm`, `−200 nm`.
export function shortLength(value_m) {
  const [unit, size] = lengthUnit(value_m);
  return `${String(+(value_m / size).toPrecision(7)).replace("-", "−")} ${unit}`;
}

/// A number with at most ten digits: as it is, or with an exponent where that is shorter.
export function plain(value) {
  const rounded = Number(value.toPrecision(10));
  const [text, scientific] = [String(rounded), rounded.toExponential().replace("e+", "e")];
  return text.length <= scientific.length + 2 ? text : scientific;
}
