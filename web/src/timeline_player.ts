// The clock of the page: that of the movie, or of the page itself where there is no picture that the browser plays.

export class Player {
  /** What happens as the player starts and stops. */
  onchange: () => void = () => undefined;
  private isRunning = false;
  private startedAt = 0;
  private from = 0;
  private pace = 1;
  private hasMovie = false;

  /** `touchEnd` is the second at which the last track ends. */
  constructor(private readonly movie: HTMLVideoElement, private readonly touchEnd: () => number) {}

  /**
   * Take a movie as the clock. `lost` is told why if the browser does not play it; `blind` is called if the browser plays its
   * sound alone, as it does without a word where it lacks the codec of the picture.
   */
  open(data: Uint8Array<ArrayBuffer>, type: string, lost: (why: string) => void, blind: () => void): void {
    this.hasMovie = true;
    this.movie.src = URL.createObjectURL(new Blob([data], { type }));
    this.movie.onended = (): void => this.pause();
    // keys of the system start and stop a movie, too
    this.movie.onplay = (): void => void (this.isRunning || this.start());
    this.movie.onpause = (): void => void (this.isRunning && !this.movie.ended && this.pause());
    this.movie.ondurationchange = (): void => this.onchange();
    this.movie.onloadedmetadata = (): void => void (this.movie.videoWidth || blind());
    this.movie.onerror = (): void => {
      this.hasMovie = false;
      this.pause();
      lost(this.movie.error?.message || "the browser gives no reason");
    };
  }

  get isPlaying(): boolean {
    return this.isRunning;
  }

  get duration(): number {
    const own = this.movie.duration;
    return Math.max(this.touchEnd(), this.hasMovie && Number.isFinite(own) ? own : 0, 0.01);
  }

  get time(): number {
    if (this.hasMovie) return this.movie.currentTime;
    if (!this.isRunning) return this.from;
    return Math.min(this.duration, this.from + (this.pace * (performance.now() - this.startedAt)) / 1000);
  }

  seek(time: number): void {
    const to = Math.min(Math.max(time, 0), this.duration);
    if (this.hasMovie) this.movie.currentTime = to;
    this.from = to;
    this.startedAt = performance.now();
  }

  setPace(pace: number): void {
    const now = this.time;
    this.pace = pace;
    this.movie.playbackRate = pace;
    if (!this.hasMovie) this.seek(now);
  }

  play(): void {
    if (this.time >= this.duration - 0.01 || this.movie.ended) this.seek(0);
    this.start();
    if (this.hasMovie) this.movie.play().catch(() => this.pause());
  }

  private start(): void {
    this.startedAt = performance.now();
    this.isRunning = true;
    this.onchange();
  }

  pause(): void {
    if (!this.isRunning) return;
    const now = this.time;
    this.isRunning = false;
    this.movie.pause();
    this.from = now;
    this.onchange();
  }

  /** Stop at the end, where no movie does it. */
  checkEnd(): void {
    if (this.isRunning && !this.hasMovie && this.time >= this.duration) this.pause();
  }
}
