// The models of the service, newest first.
export function Models() {
  return <h1>Models</h1>;
}
