// Posts a message 4 times a second while it is switched on (message: true or false). Browsers slow the timers of a hidden
// page down to one a minute, but not those of its workers. A page that is frozen or stopped does not get the messages.
const HEARTBEAT_PERIOD_MS = 250;
let timer = null;

onmessage = (event) => {
  clearInterval(timer);
  timer = event.data ? setInterval(() => postMessage(null), HEARTBEAT_PERIOD_MS) : null;
};
