// Asks Touchfield.cs without Unity: try FILE.touch [PEAK_N], then lines `seconds x y z`; prints forces, newtons.
// try --layouts: how its structs lie, as layouts.c prints those of C.
using System;
using System.Globalization;
using System.IO;
using System.Reflection;
using System.Runtime.InteropServices;
using System.Threading;

static class TryTouchfield
{
    static void Layouts()
    {
        foreach (Type type in typeof(TouchfieldNative).GetNestedTypes())
        {
            Console.WriteLine(type.Name + " " + Marshal.SizeOf(type));
            foreach (FieldInfo field in type.GetFields())
                Console.WriteLine(type.Name + "." + field.Name + " " + Marshal.OffsetOf(type, field.Name) + " "
                    + Marshal.SizeOf(field.FieldType));
        }
    }

    static double Number(string word)
    {
        return double.Parse(word, CultureInfo.InvariantCulture);
    }

    static int Main(string[] words)
    {
        if (words.Length == 1 && words[0] == "--layouts")
        {
            Layouts();
            return 0;
        }
        try
        {
            using (var medium = new TouchfieldMedium(words[0]))
            {
                if (words.Length > 1) medium.ForceMax = Number(words[1]);
                for (string line = Console.ReadLine(); line != null; line = Console.ReadLine())
                {
                    string[] told = line.Split(' ');
                    double seconds = Number(told[0]);
                    var at = new TouchfieldNative.Three
                    {
                        x = Number(told[1]), y = Number(told[2]), z = Number(told[3])
                    };
                    TouchfieldNative.Three force;
                    for (medium.Force(seconds, at, out force); !medium.IsReady(seconds); Thread.Sleep(1))
                        medium.Force(seconds, at, out force); // tells the decoder where it is
                    medium.Force(seconds, at, out force);
                    Console.WriteLine(string.Format(CultureInfo.InvariantCulture, "{0:R} {1:R} {2:R}", force.x, force.y,
                        force.z));
                }
            }
        }
        catch (InvalidDataException error)
        {
            Console.Error.WriteLine(error.Message);
            return 65;
        }
        return 0;
    }
}
