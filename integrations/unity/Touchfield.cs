// A .touch file in Unity, or in any C#: the library `touchfield` (touchfield.h), a player, a haptic loop, and a component.
// Copy this file and the library into Assets/Plugins.
using System;
using System.Diagnostics;
using System.IO;
using System.Runtime.InteropServices;
using System.Threading;

// A position, metres, or a force, newtons, in the axes of the medium.
[StructLayout(LayoutKind.Sequential)]
public struct TouchfieldVector
{
    public double x, y, z;

    public TouchfieldVector(double x, double y, double z)
    {
        this.x = x;
        this.y = y;
        this.z = z;
    }
}

// What the maker of a device states, and how the medium is rendered; the defaults are safe for a hand.
public sealed class TouchfieldOptions
{
    public double ForceMaxN; // greatest force of the device; 0: that of the medium
    public double ForceContinuousN; // that the device bears for long; 0: not stated
    public double Friction = -1; // mu; below 0: that of the medium
    public double DampingNsPerM = -1; // everywhere; below 0: that of the medium, and in contact the stable value
    public double CouplingNPerM = -1; // of a virtual coupling; 0: none; below 0: the stable value
    public double WallNPerM; // stiffness of the proxy's walls; 0: measured in the medium
    public double RateHz = 1000; // of the ticks
    public double Speed = 1; // seconds of the medium for one second
    public double StartS; // time of the medium at which it starts
    public bool IsLoop;
    public bool IsComplete; // no frame is left out, however late: for a simulation that waits with IsReady
}

// Plays a file: proxy at walls, friction, damping, limits of the force and ramp. A thread of its own decodes ahead. One
// thread calls Tick or Advance, which do not wait or allocate; one thread gives the orders Play, Pause, Seek and Stop.
public sealed class TouchfieldPlayer : IDisposable
{
    readonly IntPtr handle;
    readonly Thread decoder;
    readonly double rateHz;
    volatile bool isClosing;
    bool isClosed, hasPosition;
    TouchfieldVector position; // of the latest Advance
    double clockS;

    public readonly string Axes; // of the medium, such as "x right, y down, z forward"
    public readonly double DurationS, ForceMaxN; // of the medium

    public TouchfieldPlayer(string path) : this(path, new TouchfieldOptions())
    {
    }

    public TouchfieldPlayer(string path, TouchfieldOptions options) : this(File.ReadAllBytes(path), path, options)
    {
    }

    // Opens the bytes of a file; `name` is for messages. InvalidDataException: the file cannot be played.
    public TouchfieldPlayer(byte[] file, string name, TouchfieldOptions options)
    {
        handle = Native.touchfield_open(file, (ulong)file.Length);
        if (handle == IntPtr.Zero) throw new OutOfMemoryException();
        rateHz = options.RateHz;
        Set(options);
        if (Native.touchfield_start(handle) != 0)
        {
            string error = Error;
            Dispose();
            throw new InvalidDataException(name + ": " + error);
        }
        Axes = Marshal.PtrToStringAnsi(Native.touchfield_axes(handle));
        DurationS = Native.touchfield_duration_s(handle);
        ForceMaxN = Native.touchfield_force_max_n(handle);
        decoder = new Thread(DecodeAhead) { IsBackground = true, Name = "touchfield-decoder" };
        decoder.Start();
    }

    // Why it plays no longer, or that the thread that decodes hangs; or "". Then the force goes to zero.
    public string Error { get { return isClosed ? "" : Marshal.PtrToStringAnsi(Native.touchfield_error(handle)); } }

    // Time of the medium at the latest tick, seconds.
    public double TimeS { get { return isClosed ? 0 : Native.touchfield_media_s(handle); } }

    // Whether the force is zero after Stop.
    public bool IsReleased { get { return isClosed || Native.touchfield_is_released(handle) != 0; } }

    // Whether the medium has ended and the force is zero.
    public bool IsOver { get { return isClosed || Native.touchfield_is_over(handle) != 0; } }

    public void Play()
    {
        if (!isClosed) Native.touchfield_resume(handle);
    }

    // The medium stands, and its force stays.
    public void Pause()
    {
        if (!isClosed) Native.touchfield_pause(handle);
    }

    // Goes on at a time of the medium, seconds.
    public void Seek(double timeS)
    {
        if (!isClosed) Native.touchfield_seek(handle, timeS);
    }

    // Brings the force to zero for ever, within the ramp: tick until IsReleased.
    public void Stop()
    {
        if (!isClosed) Native.touchfield_stop(handle);
    }

    // The force on a hand at a position, now. False: it is zero, as after Dispose.
    public bool Tick(TouchfieldVector positionM, out TouchfieldVector forceN)
    {
        return Tick(positionM, Stopwatch.GetTimestamp() / (double)Stopwatch.Frequency, out forceN);
    }

    // The same by a clock of the caller's, seconds, which does not go back.
    public bool Tick(TouchfieldVector positionM, double clockS, out TouchfieldVector forceN)
    {
        forceN = new TouchfieldVector();
        return !isClosed && Native.touchfield_tick(handle, positionM.x, positionM.y, positionM.z,
            Nanoseconds(clockS), out forceN) != 0;
    }

    // Whether a tick at that time of the caller's clock finds its frames decoded: for simulations, which may wait.
    public bool IsReady(double clockS)
    {
        return isClosed || Native.touchfield_is_ready(handle, Nanoseconds(clockS)) != 0;
    }

    // The force after some seconds in which the hand moves straight to a position: ticks at RateHz of simulated time.
    // For loops that are slower than a device's, such as FixedUpdate.
    public bool Advance(TouchfieldVector positionM, double seconds, out TouchfieldVector forceN)
    {
        TouchfieldVector start = hasPosition ? position : positionM;
        int ticks = Math.Max(1, (int)Math.Round(seconds * rateHz));
        bool hasForce = false;
        forceN = new TouchfieldVector();
        for (int n = 1; n <= ticks; n++)
        {
            double t = n / (double)ticks;
            position = new TouchfieldVector(start.x + t * (positionM.x - start.x),
                start.y + t * (positionM.y - start.y), start.z + t * (positionM.z - start.z));
            hasForce = Tick(position, clockS + t * seconds, out forceN);
        }
        hasPosition = true;
        clockS += seconds;
        return hasForce;
    }

    // Frees the player; no other thread may use it then. The force does not ramp: call Stop before.
    public void Dispose()
    {
        if (isClosed) return;
        isClosed = isClosing = true;
        if (decoder != null) decoder.Join();
        Native.touchfield_close(handle);
    }

    static long Nanoseconds(double seconds)
    {
        return (long)Math.Round(1e9 * seconds);
    }

    void Set(TouchfieldOptions options)
    {
        Set("force_max_n", options.ForceMaxN);
        Set("force_continuous_n", options.ForceContinuousN);
        Set("friction", options.Friction < 0 ? -1 : options.Friction);
        Set("damping_n_s_per_m", options.DampingNsPerM < 0 ? -1 : options.DampingNsPerM);
        Set("coupling_n_per_m", options.CouplingNPerM < 0 ? -1 : options.CouplingNPerM);
        Set("wall_n_per_m", options.WallNPerM);
        Set("rate_hz", options.RateHz);
        Set("speed", options.Speed);
        Set("start_s", options.StartS);
        Set("is_loop", options.IsLoop ? 1 : 0);
        Set("is_complete", options.IsComplete ? 1 : 0);
    }

    void Set(string option, double value)
    {
        if (Native.touchfield_set(handle, option, value) != 0) return;
        Dispose();
        throw new ArgumentException(option + " is " + value);
    }

    void DecodeAhead()
    {
        while (!isClosing)
            if (Native.touchfield_decode(handle) == 0) Thread.Sleep(1);
    }

    // The functions of touchfield.h.
    static class Native
    {
#if (UNITY_IOS || UNITY_WEBGL) && !UNITY_EDITOR
        const string Library = "__Internal";
#else
        const string Library = "touchfield";
#endif
        const CallingConvention Cdecl = CallingConvention.Cdecl;

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern IntPtr touchfield_open(byte[] bytes, ulong size);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern void touchfield_close(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern IntPtr touchfield_error(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern IntPtr touchfield_axes(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern double touchfield_duration_s(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern double touchfield_force_max_n(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_set(IntPtr player, [MarshalAs(UnmanagedType.LPStr)] string option,
            double value);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_start(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_decode(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_tick(IntPtr player, double x, double y, double z, long now_ns,
            out TouchfieldVector force_n);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_is_ready(IntPtr player, long now_ns);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern void touchfield_resume(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern void touchfield_pause(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern void touchfield_seek(IntPtr player, double time_s);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern void touchfield_stop(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_is_released(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern int touchfield_is_over(IntPtr player);

        [DllImport(Library, CallingConvention = Cdecl)]
        public static extern double touchfield_media_s(IntPtr player);
    }
}

// A device of one point, as TouchfieldLoop calls it: from one thread, in the axes of the medium.
public interface ITouchfieldDevice
{
    TouchfieldVector ReadPositionM();
    void WriteForceN(TouchfieldVector forceN);
}

// A haptic loop for a device, in a thread of its own. Dispose brings the force to zero.
public sealed class TouchfieldLoop : IDisposable
{
    readonly TouchfieldPlayer player;
    readonly ITouchfieldDevice device;
    readonly double rateHz;
    readonly Thread thread;

    public TouchfieldLoop(TouchfieldPlayer player, ITouchfieldDevice device, double rateHz)
    {
        this.player = player;
        this.device = device;
        this.rateHz = rateHz;
        thread = new Thread(Run) { IsBackground = true, Name = "touchfield-loop", Priority = ThreadPriority.Highest };
        thread.Start();
    }

    // What the device has thrown, or null. Then the force has gone to zero, as far as the device took it, and the loop ends.
    public Exception Error { get; private set; }

    public void Dispose()
    {
        player.Stop();
        thread.Join();
    }

    void Run()
    {
        long start = Stopwatch.GetTimestamp();
        bool hasForce = true;
        for (long n = 1; !player.IsReleased && (Error == null || hasForce); n++)
        {
            TouchfieldVector forceN;
            hasForce = player.Tick(ReadPositionM(), out forceN);
            WriteForceN(forceN);
            // sleeping takes more than a millisecond on some systems
            while (Stopwatch.GetTimestamp() - start < n * Stopwatch.Frequency / rateHz) Thread.Yield();
        }
    }

    // Without a position the force goes to zero, within the ramp.
    TouchfieldVector ReadPositionM()
    {
        try
        {
            if (Error == null) return device.ReadPositionM();
        }
        catch (Exception error)
        {
            Error = error;
        }
        return new TouchfieldVector(double.NaN, double.NaN, double.NaN);
    }

    void WriteForceN(TouchfieldVector forceN)
    {
        try
        {
            device.WriteForceN(forceN);
        }
        catch (Exception error)
        {
            if (Error == null) Error = error;
        }
    }
}

#if UNITY_5_3_OR_NEWER
// Plays a file of StreamingAssets at this object's position. `Newtons` is the force on `hand`, in the axes of the world.
public sealed class Touchfield : UnityEngine.MonoBehaviour
{
    public string file = "terrain.touch";
    public UnityEngine.Transform hand;
    public bool loop = true;
    // Where the medium's x, y and z (TouchfieldPlayer.Axes) point in this object, whose own axes are left-handed.
    public UnityEngine.Vector3 x = UnityEngine.Vector3.right, y = UnityEngine.Vector3.down,
        z = UnityEngine.Vector3.forward;

    public UnityEngine.Vector3 Newtons { get; private set; }
    public TouchfieldPlayer Player { get; private set; }

    void OnEnable()
    {
        string path = Path.Combine(UnityEngine.Application.streamingAssetsPath, file);
        Player = new TouchfieldPlayer(path, new TouchfieldOptions { IsLoop = loop });
        Player.Play();
    }

    void OnDisable()
    {
        if (Player != null) Player.Dispose();
        Player = null;
        Newtons = UnityEngine.Vector3.zero;
    }

    // For a hand that is shown or simulated; for a device, use TouchfieldLoop instead of this component.
    void FixedUpdate()
    {
        UnityEngine.Vector3 p = transform.InverseTransformPoint(hand.position);
        var position = new TouchfieldVector(UnityEngine.Vector3.Dot(p, x), UnityEngine.Vector3.Dot(p, y),
            UnityEngine.Vector3.Dot(p, z));
        TouchfieldVector force;
        Player.Advance(position, UnityEngine.Time.fixedDeltaTime, out force);
        Newtons = transform.TransformDirection((float)force.x * x + (float)force.y * y + (float)force.z * z);
    }
}
#endif
