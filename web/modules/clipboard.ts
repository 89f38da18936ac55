// Text on the clipboard, also where the browser keeps the clipboard from pages (plain HTTP).

/** Put the text on the clipboard; throws where the browser lets no page copy. */
export async function putOnClipboard(text: string): Promise<void> {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    putBySelection(text);
  }
}

function putBySelection(text: string): void {
  const area = document.createElement("textarea");
  area.value = text;
  area.className = "visually-hidden";
  area.setAttribute("aria-hidden", "true");
  document.body.append(area);
  area.select();
  const isCopied = document.execCommand("copy");
  area.remove();
  if (!isCopied) throw new Error("the browser does not let pages copy");
}
