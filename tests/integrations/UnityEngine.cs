// What the component of integrations/unity needs of Unity, so that it can be compiled without it.
namespace UnityEngine
{
    public struct Vector3
    {
        public float x, y, z;
        public static Vector3 right, down, forward, zero;
        public static float Dot(Vector3 a, Vector3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
        public static Vector3 operator *(float s, Vector3 a) { return new Vector3 { x = s * a.x, y = s * a.y, z = s * a.z }; }
        public static Vector3 operator +(Vector3 a, Vector3 b)
        {
            return new Vector3 { x = a.x + b.x, y = a.y + b.y, z = a.z + b.z };
        }
    }

    public class Transform
    {
        public Vector3 position;
        public Vector3 InverseTransformPoint(Vector3 point) { return point; }
        public Vector3 TransformDirection(Vector3 direction) { return direction; }
    }

    public class MonoBehaviour
    {
        public Transform transform = new Transform();
    }

    public static class Application
    {
        public static string streamingAssetsPath = "";
    }

    public static class Time
    {
        public static float fixedDeltaTime = 0.02f;
    }
}
