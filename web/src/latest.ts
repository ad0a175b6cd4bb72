// Runs what a pointer or a key requests faster than it can be done.

/** The latest of several calls: one runs, one waits, and those between are passed over. */
export function latestOf<A extends unknown[]>(run: (...args: A) => Promise<void>, failed: (error: unknown) => void): (...args: A) => void {
  let isBusy = false;
  let waiting: A | null = null;
  const go = async (...args: A): Promise<void> => {
    if (isBusy) return void (waiting = args);
    isBusy = true;
    try {
      await run(...args);
    } catch (error) {
      failed(error);
    }
    isBusy = false;
    if (waiting) {
      const next = waiting;
      waiting = null;
      void go(...next);
    }
  };
  return (...args) => void go(...args);
}
