// Runs Touchfield.cs without Unity: try [-p PEAK_N] [-m FRICTION] [-d DAMPING] [-c COUPLING] [-k WALL] [-a TICKS] [-f TICK]
// [-l] [-r] FILE reads positions, a line `x y z` in metres for each tick of 1 ms, and prints the force of each, newtons. At the end it
// stops, and prints the forces on the way to zero. Time is simulated, or with -r real, in a TouchfieldLoop; with -a a line is
// a step of so many ticks, as in FixedUpdate; with -f the device fails at that tick.
using System;
using System.Collections.Generic;
using System.Globalization;
using System.IO;
using System.Threading;

static class TryTouchfield
{
    static readonly TouchfieldOptions options = new TouchfieldOptions();
    static int ticksPerStep, failingTick = int.MaxValue;
    static bool isRealTime;

    // A device that moves along the lines, one a tick, and records its forces.
    sealed class Recorder : ITouchfieldDevice
    {
        readonly List<TouchfieldVector> positions;
        public readonly List<TouchfieldVector> Forces = new List<TouchfieldVector>();

        public Recorder(List<TouchfieldVector> positions)
        {
            this.positions = positions;
        }

        public bool IsDone { get { return Forces.Count >= positions.Count; } }

        public TouchfieldVector ReadPositionM()
        {
            if (Forces.Count >= failingTick) throw new IOException("the device does not answer");
            return positions[Math.Min(Forces.Count, positions.Count - 1)];
        }

        public void WriteForceN(TouchfieldVector forceN)
        {
            Forces.Add(forceN);
        }
    }

    static double Number(string word)
    {
        return double.Parse(word, CultureInfo.InvariantCulture);
    }

    static string ReadOptions(string[] words)
    {
        int n = 0;
        for (; n + 1 < words.Length; n++)
            switch (words[n])
            {
                case "-l": options.IsLoop = true; break;
                case "-r": isRealTime = true; break;
                case "-p": options.ForceMaxN = Number(words[++n]); break;
                case "-m": options.Friction = Number(words[++n]); break;
                case "-d": options.DampingNsPerM = Number(words[++n]); break;
                case "-c": options.CouplingNPerM = Number(words[++n]); break;
                case "-k": options.WallNPerM = Number(words[++n]); break;
                case "-f": failingTick = (int)Number(words[++n]); break;
                case "-a": ticksPerStep = (int)Number(words[++n]); break;
                default: return null;
            }
        options.IsComplete = !isRealTime;
        return n + 1 == words.Length ? words[n] : null;
    }

    static List<TouchfieldVector> ReadPositions()
    {
        var positions = new List<TouchfieldVector>();
        for (string line = Console.ReadLine(); line != null; line = Console.ReadLine())
        {
            string[] words = line.Split(' ');
            positions.Add(new TouchfieldVector(Number(words[0]), Number(words[1]), Number(words[2])));
        }
        return positions;
    }

    static void RunSimulated(TouchfieldPlayer player, Recorder device)
    {
        TouchfieldVector force;
        for (int n = 0; !player.IsReleased; n++)
        {
            if (device.IsDone) player.Stop();
            while (!player.IsReady(1e-3 * n)) Thread.Sleep(0);
            player.Tick(device.ReadPositionM(), 1e-3 * n, out force);
            device.WriteForceN(force);
        }
    }

    static void RunSteps(TouchfieldPlayer player, Recorder device)
    {
        TouchfieldVector force;
        while (!player.IsReady(0)) Thread.Sleep(1); // later frames are decoded in the time that is simulated
        while (!player.IsReleased)
        {
            if (device.IsDone) player.Stop();
            player.Advance(device.ReadPositionM(), 1e-3 * ticksPerStep, out force);
            device.WriteForceN(force);
        }
    }

    static void RunRealTime(TouchfieldPlayer player, Recorder device)
    {
        using (var loop = new TouchfieldLoop(player, device, options.RateHz))
        {
            while (!device.IsDone && loop.Error == null) Thread.Sleep(1);
            Thread.Sleep(loop.Error == null ? 0 : 100);
        }
    }

    static int Main(string[] words)
    {
        string path = ReadOptions(words);
        if (path == null)
        {
            Console.Error.WriteLine("try.exe: [-p PEAK_N] [-m FRICTION] [-l] [-r] FILE.touch < HAND.txt");
            return 64;
        }
        try
        {
            var device = new Recorder(ReadPositions());
            using (var player = new TouchfieldPlayer(path, options))
            {
                player.Play();
                if (isRealTime) RunRealTime(player, device);
                else if (ticksPerStep > 0) RunSteps(player, device);
                else RunSimulated(player, device);
            }
            foreach (TouchfieldVector f in device.Forces)
                Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0:R} {1:R} {2:R}", f.x, f.y, f.z));
            return 0;
        }
        catch (InvalidDataException error)
        {
            Console.Error.WriteLine(error.Message);
            return 65;
        }
        catch (IOException error)
        {
            Console.Error.WriteLine(path + ": " + error.Message);
            return 66;
        }
    }
}
