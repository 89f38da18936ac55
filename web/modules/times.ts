// Times in the reader's zone: a cookie sets it for the next pages, and this page's UTC times are rewritten.

const COOKIE = "stone_zone";

export function installTimes(): void {
  const zone = Intl.DateTimeFormat().resolvedOptions().timeZone;
  const isTold = document.cookie.split("; ").includes(`${COOKIE}=${zone}`);
  if (isTold || !zone) return;
  document.cookie = `${COOKIE}=${zone}; Path=/; Max-Age=31536000; SameSite=Lax`;
  for (const time of document.querySelectorAll<HTMLTimeElement>("time[datetime]")) time.textContent = written(new Date(time.dateTime), time.hasAttribute("data-exact"));
}

/** `2026-11-21 20:10` in the reader's zone, as the server writes it; with `isExact` to the second. */
export function written(moment: Date, isExact = false): string {
  const two = (value: number): string => String(value).padStart(2, "0");
  const day = `${moment.getFullYear()}-${two(moment.getMonth() + 1)}-${two(moment.getDate())}`;
  const minute = `${day} ${two(moment.getHours())}:${two(moment.getMinutes())}`;
  return isExact ? `${minute}:${two(moment.getSeconds())}` : minute;
}
