export default function Page() {
  return <h1>batches</h1>;
}
