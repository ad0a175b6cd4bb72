// A .touch file in Unity, or in any C#: the library `touchfield` (c/touch.h), and a component that plays a file.
// Copy this file and the library into Assets/Plugins.
using System;
using System.IO;
using System.Runtime.InteropServices;
using System.Threading;

// The structs and functions of c/touch.h, by their names there; a pointer is an IntPtr.
public static class TouchfieldNative
{
#if (UNITY_IOS || UNITY_WEBGL) && !UNITY_EDITOR
    const string Library = "__Internal";
#else
    const string Library = "touchfield";
#endif
    public const int Ok = 0, Foreign = 1, Cut = 2, Corrupt = 3, Version = 4, Memory = 5, Argument = 6, End = 7;

    [StructLayout(LayoutKind.Sequential)]
    public struct Counts
    {
        public uint x, y, z;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct Three
    {
        public double x, y, z;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct Nine
    {
        public Three x, y, z;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_arena
    {
        public IntPtr @base;
        public ulong size, used, peak;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_grid
    {
        public Counts shape;
        public Three spacing_m, origin_m;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_bytes
    {
        public IntPtr bytes;
        public ulong size;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_file
    {
        public IntPtr data;
        public ulong size;
        public touch_grid grid;
        public double rate_hz, force_max_n, mapping_scale;
        public Three mapping_offset_m;
        public double weber_fraction, force_threshold_n, friction, damping_n_s_per_m;
        public uint frame_count, segment_count, object_count;
        public int device_type;
        public touch_bytes axes, device_name, coder, parameters, index;
        public IntPtr error;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_field
    {
        public touch_grid grid;
        public uint bricks, mask;
        public IntPtr table, forces_n;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_part
    {
        public IntPtr field;
        public Nine rotation;
        public Three position_m, velocity_m_s, spin_rad_s;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_frame
    {
        public uint number, parts;
        public int is_placed;
        public IntPtr part;
        public double surface_damping_n_s_per_m, force_max_n;
        public IntPtr vibration;
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct touch_decoder
    {
        public IntPtr file;
        public touch_arena arena;
        public ulong kept;
        public IntPtr state, error;
    }

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern touch_arena touch_arena_of(IntPtr memory, ulong size);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_open(IntPtr file, IntPtr bytes, ulong size);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touch_room(IntPtr file, out ulong decoder, out ulong frame);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_start(IntPtr decoder, IntPtr file, touch_arena arena);

    // A segment's body from elsewhere than a file, such as a live stream.
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_start_body(IntPtr decoder, IntPtr grid, touch_bytes parameters, touch_bytes body,
        uint frame_count, touch_arena arena);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touch_body_room(IntPtr grid, touch_bytes body, out ulong decoder, out ulong frame);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern uint touch_segment_of(IntPtr file, uint frame);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_seek(IntPtr decoder, uint segment);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_next(IntPtr decoder, ref touch_arena arena, IntPtr frame);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_is_rigid(IntPtr decoder, uint body);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern int touch_mask_of(IntPtr decoder, uint body, out double k, out double f0_n);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touch_force(IntPtr frame, double x, double y, double z, out Three newtons);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touch_gradient(IntPtr frame, double x, double y, double z, out Nine n_per_m);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touch_vibration(IntPtr frame, double x, double y, double z, [Out] double[] both);

    // Of integrations/between.h: frame `a` at t = 0, the next one, `b`, at t = 1, no longer than `most` newtons.
    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    public static extern void touchfield_force_between(IntPtr a, IntPtr b, double t, ref Three at, double most,
        out Three newtons);
}

// A file that plays forward: a thread decodes ahead, and Force neither waits nor allocates. One thread asks it.
public sealed class TouchfieldMedium : IDisposable
{
    const int Slots = 4;

    readonly IntPtr bytes, file, memory, frames;
    // Of even and odd segments: bodies that change live in one until it seeks again.
    readonly IntPtr[] decoders = new IntPtr[2];
    readonly TouchfieldNative.touch_arena[] arenas = new TouchfieldNative.touch_arena[Slots];
    readonly int frameSize = Marshal.SizeOf(typeof(TouchfieldNative.touch_frame));
    readonly Thread thread;
    long newest = -1, oldest; // frames: decoded, and still felt
    volatile bool isOver;
    bool isFreed;

    public readonly TouchfieldNative.touch_file Head;
    public readonly string Axes; // such as "x right, y down, z forward"
    public double ForceMax; // newtons; what the medium says, or less

    public TouchfieldMedium(string path)
    {
        byte[] read = File.ReadAllBytes(path);
        try
        {
            bytes = Marshal.AllocHGlobal(read.Length + 1);
            Marshal.Copy(read, 0, bytes, read.Length);
            file = Marshal.AllocHGlobal(Marshal.SizeOf(typeof(TouchfieldNative.touch_file)));
            int code = TouchfieldNative.touch_open(file, bytes, (ulong)read.Length);
            Head = (TouchfieldNative.touch_file)Marshal.PtrToStructure(file, typeof(TouchfieldNative.touch_file));
            if (code != TouchfieldNative.Ok)
                throw new InvalidDataException(path + ": " + Marshal.PtrToStringAnsi(Head.error));
            Axes = Marshal.PtrToStringAnsi(Head.axes.bytes, (int)Head.axes.size);
            ForceMax = Head.force_max_n;
            ulong own, each;
            TouchfieldNative.touch_room(file, out own, out each);
            memory = Marshal.AllocHGlobal(new IntPtr(checked((long)(2 * own + Slots * each))));
            frames = Marshal.AllocHGlobal(Slots * frameSize);
            for (int n = 0; n < 2; n++)
                decoders[n] = Started(path, new IntPtr(memory.ToInt64() + n * (long)own), own);
            for (int n = 0; n < Slots; n++)
                arenas[n] = TouchfieldNative.touch_arena_of(
                    new IntPtr(memory.ToInt64() + 2 * (long)own + n * (long)each), each);
            thread = new Thread(DecodeAhead) { IsBackground = true };
            thread.Start();
        }
        catch
        {
            Dispose();
            throw;
        }
    }

    public double Seconds { get { return Head.frame_count / Head.rate_hz; } }

    // Whether all that this time needs is decoded; else the newest frame there is would be felt.
    public bool IsReady(double seconds)
    {
        return isOver || FrameAt(seconds) <= Interlocked.Read(ref newest);
    }

    // The force at a point, metres, in the medium's axes; time must not go back. False where there is none, as after
    // Dispose, for which no other thread may be asking.
    public bool Force(double seconds, TouchfieldNative.Three at, out TouchfieldNative.Three newtons)
    {
        newtons = new TouchfieldNative.Three();
        long last = Interlocked.Read(ref newest);
        if (last < 0 || isOver) return false;
        double frame = Math.Min(FrameAt(seconds), last);
        long a = Math.Max((long)frame, Interlocked.Read(ref oldest));
        Interlocked.Exchange(ref oldest, a);
        TouchfieldNative.touchfield_force_between(Frame(a), Frame(Math.Min(a + 1, last)), frame - a, ref at,
            Math.Min(ForceMax, Head.force_max_n), out newtons);
        return newtons.x != 0 || newtons.y != 0 || newtons.z != 0;
    }

    public void Dispose()
    {
        isOver = true;
        if (thread != null && thread.IsAlive) thread.Join();
        foreach (IntPtr block in new[] { decoders[0], decoders[1], frames, memory, file, bytes })
            if (!isFreed) Marshal.FreeHGlobal(block);
        isFreed = true;
    }

    double FrameAt(double seconds)
    {
        return Math.Max(0.0, Math.Min(seconds * Head.rate_hz, Head.frame_count - 1.0));
    }

    IntPtr Frame(long number)
    {
        return new IntPtr(frames.ToInt64() + number % Slots * frameSize);
    }

    IntPtr Started(string path, IntPtr at, ulong size)
    {
        IntPtr decoder = Marshal.AllocHGlobal(Marshal.SizeOf(typeof(TouchfieldNative.touch_decoder)));
        var arena = TouchfieldNative.touch_arena_of(at, size);
        if (TouchfieldNative.touch_start(decoder, file, arena) == TouchfieldNative.Ok) return decoder;
        var told = (TouchfieldNative.touch_decoder)Marshal.PtrToStructure(
            decoder, typeof(TouchfieldNative.touch_decoder));
        Marshal.FreeHGlobal(decoder);
        throw new InvalidDataException(path + ": " + Marshal.PtrToStringAnsi(told.error));
    }

    // Until no frame before this one is felt; false when it is over.
    bool WaitFor(long frame)
    {
        while (Interlocked.Read(ref oldest) < frame && !isOver) Thread.Sleep(1);
        return !isOver;
    }

    void DecodeAhead()
    {
        long n = 0, before = 0;
        for (uint segment = 0; segment < Head.segment_count; segment++)
        {
            IntPtr decoder = decoders[segment & 1];
            if (!WaitFor(before)) return; // nothing of the segment before the last one is felt any longer
            before = n;
            int code = TouchfieldNative.touch_seek(decoder, segment);
            while (code == TouchfieldNative.Ok)
            {
                if (!WaitFor(n - Slots + 1)) return;
                arenas[n % Slots].used = 0;
                code = TouchfieldNative.touch_next(decoder, ref arenas[n % Slots], Frame(n));
                if (code == TouchfieldNative.Ok) Interlocked.Exchange(ref newest, n++);
            }
            if (code == TouchfieldNative.End) continue;
            isOver = true; // a file that contradicts itself: the force ends
            return;
        }
    }
}

#if UNITY_5_3_OR_NEWER
// Plays a file of StreamingAssets at this object's place; `Newtons` is what the hand feels, in the world's axes.
public sealed class Touchfield : UnityEngine.MonoBehaviour
{
    public string file = "terrain.touch";
    public UnityEngine.Transform hand;
    // Where the medium's x, y and z (TouchfieldMedium.Axes) point in this object, whose own axes are left-handed.
    public UnityEngine.Vector3 x = UnityEngine.Vector3.right, y = UnityEngine.Vector3.down,
        z = UnityEngine.Vector3.forward;

    public UnityEngine.Vector3 Newtons { get; private set; }

    TouchfieldMedium medium;
    double started;

    void OnEnable()
    {
        medium = new TouchfieldMedium(Path.Combine(UnityEngine.Application.streamingAssetsPath, file));
        started = UnityEngine.Time.fixedTime;
    }

    void OnDisable()
    {
        if (medium != null) medium.Dispose();
        medium = null;
        Newtons = UnityEngine.Vector3.zero;
    }

    // Physics' rate is enough to show a force; a device asks `medium` from a thread of its own, 1000 times a second.
    void FixedUpdate()
    {
        UnityEngine.Vector3 there = transform.InverseTransformPoint(hand.position);
        var at = new TouchfieldNative.Three
        {
            x = UnityEngine.Vector3.Dot(there, x),
            y = UnityEngine.Vector3.Dot(there, y),
            z = UnityEngine.Vector3.Dot(there, z),
        };
        TouchfieldNative.Three force;
        medium.Force(UnityEngine.Time.fixedTime - started, at, out force);
        Newtons = transform.TransformDirection((float)force.x * x + (float)force.y * y + (float)force.z * z);
    }
}
#endif
