// Beats 4 times a second while it is told to (message: true or false). The timers of a page in the background are slowed
// down to one a minute, those of its worker are not. A page that is frozen or stopped does not hear the beats.
const PERIOD_MS = 250;
let timer = null;

onmessage = (event) => {
  clearInterval(timer);
  timer = event.data ? setInterval(() => postMessage(null), PERIOD_MS) : null;
};
