export default function Page() {
  return <h1>request</h1>;
}
